"""A tiny moving scene, and the paired capture that four cameras make of it."""

import contextlib
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gaussray.camera.aperture import Aperture
from gaussray.camera.camera import Camera
from gaussray.camera.film import Film
from gaussray.camera.lens import pinhole
from gaussray.camera.shutter import Shutter
from gaussray.camera.trajectory import Trajectory
from gaussray.dataset.images import write_image
from gaussray.dataset.manifest import FrameRecord, write_manifest
from gaussray.geometry import quaternion
from gaussray.reconstruct.data.pictures import Footage
from gaussray.reconstruct.data.tiles import cut, tile_pixels
from gaussray.reconstruct.initialize.body_tracking import TrackOptions
from gaussray.reconstruct.log import RunLog
from gaussray.reconstruct.optimize.density import DensityOptions
from gaussray.reconstruct.options import FitOptions, ReconstructOptions
from gaussray.reconstruct.simplify.prune import PruneOptions
from gaussray.render.dataset import render_dataset
from gaussray.render.options import RenderOptions
from gaussray.render.renderer import Renderer
from gaussray.scene.bodies import bodies_at_rest
from gaussray.scene.control_points import ControlPoints
from gaussray.scene.deformation import Deformation, FieldOptions, Layer, deform, initial_deformation
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.harmonics import C0, constant_harmonics
from gaussray.scene.planes import initial_planes
from gaussray.scene.scene import Scene, at
from gaussray.scene.transient import Transients
from gaussray.tracer.options import TraceOptions


SIZE = 16
CAMERAS = ("cam_0", "cam_1", "cam_2", "cam_3")
TIMES = (0.0, 0.5, 1.0)
# No level of coarser bundles: a picture of 16 x 16 has four bundles in all.
TRACE = TraceOptions(levels=0, group=2, chunk=8)
# One block of steps per stage; what they find is poor. There is room for as many Gaussians as in
# other fits of the tests, with which it shares its programs.
SHORT = ReconstructOptions(
    fit=FitOptions(
        auto=False, coarse=10, fine=10, tiles=4, block=10, points=27, surround=0.0, start="given"
    ),
    track=TrackOptions(poses=0),
    field=FieldOptions(sides=(4, 6), channels=4, width=8),
    trace=TraceOptions(levels=0, group=2, chunk=8, transmittance_min=1e-2),
    density=DensityOptions(interval=20),
    prune=PruneOptions(loss=0.0),
)


deformed = jax.jit(deform)


def single(x) -> jax.Array:
    """In the precision that the program works in."""
    return jnp.asarray(x, jnp.float32)


def gaussians(mean, scale, color, opacity=0.9) -> Gaussians:
    """Round Gaussians of these places, sizes and colours."""
    mean = np.atleast_2d(np.asarray(mean, np.float32))
    count = len(mean)
    quat = np.tile(np.float32([1, 0, 0, 0]), (count, 1))
    scale = np.broadcast_to(np.float32(scale).reshape(-1, 1), (count, 3))
    color = np.broadcast_to(np.float32(color), (count, 3))
    opacity = np.full(count, opacity, np.float32)
    parts = (single(x) for x in (mean, quat, scale, opacity))
    return Gaussians(*parts, constant_harmonics(single(color), 0))


def transients(count: int = 5, seed: int = 0) -> Transients:
    """Random transient Gaussians about times in [0, 1]."""
    dice = np.random.default_rng(seed)
    parts = {
        "mean": dice.normal(size=(count, 3)),
        "velocity": dice.normal(size=(count, 3)),
        "quat": dice.normal(size=(count, 4)),
        "scale": dice.uniform(0.01, 0.2, (count, 3)),
        "opacity": dice.uniform(0.1, 0.9, count),
        "harmonics": dice.normal(size=(count, 1, 3)),
        "instant": dice.uniform(0, 1, count),
        "lifetime": dice.uniform(0.05, 0.2, count),
        "plateau": dice.uniform(0, 0.1, count) * (np.arange(count) % 2),
    }
    return Transients(**{k: single(v) for k, v in parts.items()})


def control_points(instants: int = 3) -> ControlPoints:
    """Three control points that move along +x and turn about +z, each faster than the last."""
    times = jnp.linspace(0, 1, instants, dtype=jnp.float32)
    speed = single([0.3, 0.5, 0.7])[:, None] * times[None]
    zero = jnp.zeros_like(speed)
    return ControlPoints(
        pivot=single([[-0.5, 0, 0], [0, 0.5, 0], [0.5, 0, 0]]),
        radius=single([0.5, 0.4, 0.3]),
        time=times,
        path=jnp.stack([speed, zero, zero], axis=-1),
        turn=jnp.stack([jnp.cos(speed), zero, zero, jnp.sin(speed)], axis=-1),
    )


def deformation(
    *,
    seed: int = 0,
    speed: float = 0.0,
    instants: int = 3,
    control: ControlPoints | None = None,
) -> Deformation:
    """A small field that leaves everything where it is at first and then moves it along +x, faster
    and faster, by `speed` in all for what stands at the origin."""
    planes = initial_planes(
        jax.random.key(seed), single([-1, -1, -1]), single([1, 1, 1]), (0.0, 1.0),
        sides=(4,), instants=instants, channels=4,
    )  # fmt: skip
    times = jnp.linspace(0, 1, instants, dtype=jnp.float32)
    bodies = bodies_at_rest(jnp.zeros((1, 3), jnp.float32), jnp.ones(1, jnp.float32), times)
    key = jax.random.key(seed + 1)
    field = initial_deformation(key, planes, bodies, width=8, control=control)
    if not speed:
        return field
    ramp = jnp.linspace(1.0, 4.0, instants, dtype=jnp.float32)[None, :, None, None]
    field = eqx.tree_at(lambda d: d.planes.time[0], field, planes.time[0] * ramp)
    weight = jnp.zeros_like(field.mean[1].weight).at[:, 0].set(1)
    field = eqx.tree_at(lambda d: d.mean[1].weight, field, weight)
    probe = gaussians([0, 0, 0], 0.1, [0, 0, 0])
    first, last = (deformed(probe, field, single(t)).mean[0, 0] for t in (0, 1))
    share = speed / (last - first)
    bias = jnp.zeros_like(field.mean[1].bias).at[0].set(-share * first)
    return eqx.tree_at(lambda d: d.mean[1], field, Layer(share * weight, bias))


def scene(*, speed: float = 1.0) -> Scene:
    """A wall of Gaussians that stands still, and two bright ones in front that move."""
    y, x = np.mgrid[-1:1:5j, -1:1:5j]
    wall = np.stack([x, y, np.full_like(x, 0.8)], axis=-1).reshape(-1, 3)
    shade = np.stack([0.3 + 0.2 * x, 0.4 + 0.2 * y, 0.3 + 0 * x], axis=-1).reshape(-1, 3)
    bodies = gaussians(
        [[-0.4, -0.2, 0], [-0.3, 0.4, -0.1]], 0.2, [[0.9, 0.7, 0.1], [0.1, 0.8, 0.9]]
    )
    field = deformation(speed=speed) if speed else None
    return Scene(gaussians(wall, 0.3, shade, 0.8), bodies, field, single([0, 1]))


def carried(begin: float, end: float, *, speed: float = 0.8, light: float = 1.0) -> Scene:
    """The same wall, in more or less light, and the two bodies on their way along +x at a steady
    `speed`, in the middle of which they are where the other scene begins; the motion is known from
    `begin` to `end` alone."""
    still = scene(speed=0)
    times = np.linspace(begin, end, 3)
    bodies = bodies_at_rest(single([[0, 0, 0]]), single([0.7]), single(times))
    path = single(np.stack([speed * (times - 0.5), 0 * times, 0 * times], axis=-1)[None])
    field = eqx.tree_at(
        lambda d: (d.bodies, d.mean, d.rotation, d.scale, d.tint),
        deformation(),
        (eqx.tree_at(lambda b: b.path, bodies, path), None, None, None, None),
        is_leaf=lambda x: x is None,
    )
    # The light is 1/2 + C0 x of the constant harmonic x.
    harmonics = light * (still.static.harmonics + 0.5 / C0) - 0.5 / C0
    static = eqx.tree_at(lambda g: g.harmonics, still.static, harmonics)
    return Scene(static, still.moving, field, single([begin, end]))


def camera(angle: float = 0.0, time: float = 0.0, width: int = SIZE, height: int = SIZE) -> Camera:
    """A pinhole camera that looks at the origin from 3 away, `angle` radians to the side."""
    cos, sin = np.cos(angle), np.sin(angle)
    eye = 3 * np.array([sin, 0, -cos])
    # Columns: right, down, forward.
    turn = np.stack([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]], axis=1)
    path = Trajectory(
        jnp.zeros(1, jnp.float32), single(quaternion(jnp.asarray(turn)))[None], single(eye)[None]
    )
    zero, one = single(0), single(1)
    return Camera(
        Film(width, height, "center"),
        pinhole(single([1.1 * width] * 2), single([width / 2, height / 2])),
        Aperture(zero, one, zero, one),
        Shutter(zero, zero, zero),
        path,
        single(time),
    )


def records(times=TIMES, cameras=CAMERAS) -> list[FrameRecord]:
    """What the cameras film; the last one is held out."""
    place = dict(zip(CAMERAS, (-0.45, -0.15, 0.45, 0.15), strict=True))
    return [
        FrameRecord(
            f"images/{name}/{i:04d}.png",
            camera(place[name], time),
            name,
            "test" if name == CAMERAS[-1] else "train",
        )
        for name in cameras
        for i, time in enumerate(times)
    ]


def rolling(filmed: Camera, readout: float = 0.2, direction: str = "top_to_bottom") -> Camera:
    """The camera with a rolling shutter around its time."""
    step = readout / (filmed.film.height - 1)
    shutter = Shutter(single(-readout / 2), single(step), single(0), direction=direction)
    return Camera(**(vars(filmed) | {"shutter": shutter}))


def with_effect(listed: list[FrameRecord]) -> list[FrameRecord]:
    """The records, and the first held-out one once more with a rolling shutter."""
    first = next(record for record in listed if record.split == "test")
    path = f"images/rolling_shutter/{first.camera_name}.png"
    again = rolling(first.camera)
    return [*listed, FrameRecord(path, again, first.camera_name, "test", "rolling_shutter", 1)]


def write_paired(folder: Path, filmed: Scene) -> Path:
    """A paired capture of a scene with points and an effect."""
    one = RenderOptions(samples=1)
    renderer = Renderer(filmed, options=one, trace=TRACE)
    render_dataset(renderer, with_effect(records()), folder, quiet=True)
    write_points(folder / "points3d.ply", filmed)
    return folder


def write_capture(folder: Path, filmed: Scene, times=TIMES, points: bool = True) -> Path:
    """A paired capture of a scene, with its Gaussians' centres as points."""
    listed = records(times)
    renderer = Renderer(filmed, options=RenderOptions(samples=1), trace=TRACE)
    for record in listed:
        write_image(folder / record.file_path, renderer(record.camera).color)
    extra = {"time_unit": "normalised"}
    if points:
        extra["ply_file_path"] = "points3d.ply"
        write_points(folder / "points3d.ply", filmed)
    write_manifest(folder / "transforms.json", listed, extra=extra)
    return folder


def write_points(path: Path, filmed: Scene) -> None:
    """The centres of the Gaussians at the first instant, as a PLY of grey points."""
    place = np.asarray(jax.jit(at)(filmed, filmed.time_range[0]).mean)
    head = ["ply", "format ascii 1.0", f"element vertex {len(place)}"]
    head += [f"property float {axis}" for axis in "xyz"]
    head += [f"property uchar {name}" for name in ("red", "green", "blue")]
    rows = [f"{x} {y} {z} 128 128 128" for x, y, z in place]
    path.write_text("\n".join([*head, "end_header", *rows, ""]))


def overrides(options: eqx.Module) -> list[str]:
    """Every option of a verb as a word of its command line."""
    return [
        f"{group}.{name}={list(value) if isinstance(value, tuple) else value}"
        for group, chosen in vars(options).items()
        if isinstance(chosen, eqx.Module)
        for name, value in vars(chosen).items()
    ]


def arrays(out: Path) -> dict[str, np.ndarray]:
    """What a run has stored."""
    with open(out / "scene.npz", "rb") as raw, np.load(raw) as file:
        return {name: file[name] for name in file.files}


def same_bytes(one: Path, two: Path) -> None:
    """Demand that two runs have stored the same."""
    first, second = arrays(one), arrays(two)
    assert first.keys() == second.keys()
    for name, array in first.items():
        np.testing.assert_array_equal(array, second[name], err_msg=name)


@contextlib.contextmanager
def stopped_after(monkeypatch, name: str, calls: int):
    """A run is interrupted after so many calls of this method of its log."""
    method, count = getattr(RunLog, name), []

    def stop(self, *arguments):
        method(self, *arguments)
        count.append(1)
        if len(count) == calls:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(RunLog, name, stop)
        yield


def footage_of(pictures, masks=None) -> Footage:
    """Footage of square pictures by one camera, in tiles of 8 x 8 pixels."""
    count, size = np.shape(pictures)[:2]
    one = camera(0.0, 0.0, size, size)
    pixels = tile_pixels(one.film, 8)
    packed = None
    if masks is not None:
        packed = np.stack([np.packbits(cut(mask, pixels), axis=-1) for mask in masks])
    tiles = np.stack([cut(picture, pixels) for picture in pictures])
    cameras = jax.tree.map(lambda x: jnp.stack([x] * count), one)
    return Footage(tiles, packed, cameras, np.array(["a"] * count), 8)
