"""Which cameras film a scene: a capture's, with lens, aperture, shutter or path exchanged."""

from collections.abc import Sequence
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from gaussray.camera.aperture import Aperture, no_aperture
from gaussray.camera.camera import Camera
from gaussray.camera.film import Film
from gaussray.camera.lens import (
    AbstractLens,
    FisheyePolynomial,
    KannalaBrandt,
    check_lens,
    pinhole,
)
from gaussray.camera.shutter import Shutter, global_shutter
from gaussray.camera.trajectory import Trajectory, pose_at
from gaussray.capture.calibration import PINHOLE_FILE, View, read_views
from gaussray.capture.formats import FORMATS, format_of
from gaussray.dataset.manifest import FrameRecord


class CameraOptions(eqx.Module):
    """Which of the capture's cameras: by `names` (all of `split` if empty), at which `times` (all
    if empty)."""

    split: str = eqx.field(static=True, default="test")
    names: tuple[str, ...] = eqx.field(static=True, default=())
    times: tuple[float, ...] = eqx.field(static=True, default=())


class LensOptions(eqx.Module):
    """`model`: keep (the capture's), pinhole, fisheye_polynomial or kannala_brandt.

    `fov` is the whole horizontal field of view of a pinhole, or the field of view of a fisheye, in
    degrees; `k` the coefficients; `sensor` the sensor's width and height in mm (polynomial only).
    """

    model: str = eqx.field(static=True, default="keep")
    fov: float = eqx.field(static=True, default=65.0)
    k: tuple[float, ...] = eqx.field(static=True, default=())
    sensor: tuple[float, float] = eqx.field(static=True, default=(36.0, 36.0))


class ApertureOptions(eqx.Module):
    """`radius` in scene units (0 = pinhole, -1 = the capture's own), `focus_distance` in scene
    units; see `camera.aperture.Aperture`."""

    radius: float = eqx.field(static=True, default=-1.0)
    focus_distance: float = eqx.field(static=True, default=2.5)
    focus: str = eqx.field(static=True, default="plane")
    blades: int = eqx.field(static=True, default=0)
    rotation: float = eqx.field(static=True, default=0.0)
    ratio: float = eqx.field(static=True, default=1.0)


class ShutterOptions(eqx.Module):
    """`kind`: keep (the capture's), global or rolling. `readout` is the time from the first to the
    last row and `exposure` that of each row, in the capture's unit of time; the frame's time is in
    the middle of the readout."""

    kind: str = eqx.field(static=True, default="keep")
    readout: float = eqx.field(static=True, default=0.0)
    exposure: float = eqx.field(static=True, default=0.0)
    direction: str = eqx.field(static=True, default="top_to_bottom")


class TrajectoryOptions(eqx.Module):
    """`kind`: keep (the capture's) or between (an even ride through the chosen cameras, in their
    order, over the chosen times; `steps` frames)."""

    kind: str = eqx.field(static=True, default="keep")
    steps: int = eqx.field(static=True, default=24)


class FilmOptions(eqx.Module):
    """`filter`: keep, center, box, gaussian or blackman_harris, `width` pixels wide in all."""

    filter: str = eqx.field(static=True, default="keep")
    width: float = eqx.field(static=True, default=3.0)


class RigOptions(eqx.Module):
    """All of it, one class per config group."""

    camera: CameraOptions = eqx.field(default_factory=CameraOptions)
    lens: LensOptions = eqx.field(default_factory=LensOptions)
    aperture: ApertureOptions = eqx.field(default_factory=ApertureOptions)
    shutter: ShutterOptions = eqx.field(default_factory=ShutterOptions)
    trajectory: TrajectoryOptions = eqx.field(default_factory=TrajectoryOptions)
    film: FilmOptions = eqx.field(default_factory=FilmOptions)


def rig(
    views: Sequence[View], *, options: RigOptions, samples: int, format: str = "png"
) -> list[FrameRecord]:
    """One record for every frame to be filmed, into files of this format (png or exr)."""
    if format not in ("png", "exr"):
        raise ValueError(f"format must be png (sRGB) or exr (linear light), got {format!r}.")
    chosen = _chosen(views, options.camera)
    if options.trajectory.steps < 1:
        raise ValueError(f"trajectory.steps must be at least 1, got {options.trajectory.steps}.")
    if options.trajectory.kind == "between":
        chosen = _ride(chosen, options.trajectory.steps)
    elif options.trajectory.kind != "keep":
        raise ValueError(
            f"trajectory.kind must be keep or between, got {options.trajectory.kind!r}."
        )
    changed = {
        "fisheye": options.lens.model not in ("keep", "pinhole"),
        "depth_of_field": options.aperture.radius > 0,
        "rolling_shutter": options.shutter.kind == "rolling" and options.shutter.readout != 0,
        "motion_blur": options.shutter.kind != "keep" and options.shutter.exposure > 0,
    }
    effect = "_".join(name for name, on in changed.items() if on) or "pinhole"
    records, lenses = [], {}
    for i, (name, split, camera) in enumerate(chosen):
        film = _film(camera.film, options.film)
        size = film.width, film.height
        if size not in lenses or options.lens.model == "keep":
            lenses[size] = _lens(camera, film, options.lens)
        built = Camera(
            film,
            lenses[size],
            _aperture(camera, options.aperture),
            _shutter(camera, options.shutter),
            camera.trajectory,
            camera.time,
        )
        path = f"images/{effect}/{name}/{i:04d}.{format}"
        records.append(FrameRecord(path, built, name, split, effect, samples))
    return records


def _chosen(views: Sequence[View], options: CameraOptions) -> list[tuple[str, str, Camera]]:
    known = dict.fromkeys(view.camera_name for view in views)
    for name in options.names:
        if name not in known:
            raise ValueError(
                f"camera.names must be among the capture's ({', '.join(known)}), got {name}."
            )
    picked = [
        view
        for view in views
        if (view.camera_name in options.names if options.names else view.split == options.split)
        and (not options.times or np.min(np.abs(np.array(options.times) - view.time)) < 1e-6)
    ]
    if not picked:
        raise ValueError(
            "camera.split, camera.names and camera.times choose no frame of the capture; "
            f"its cameras are {', '.join(known)}."
        )
    return [(view.camera_name, view.split, view.camera) for view in picked]


def _ride(chosen: list[tuple[str, str, Camera]], steps: int) -> list[tuple[str, str, Camera]]:
    """Frames of one camera that moves through the poses of all, while the time runs on."""
    stops = list({name: camera for name, _, camera in chosen}.values())
    if len(stops) < 2:
        raise ValueError(
            "trajectory.kind=between needs at least two cameras; name them in camera.names."
        )
    times = sorted({float(camera.time) for _, _, camera in chosen})
    poses = [pose_at(camera.trajectory, camera.time) for camera in stops]
    first, last = (times[0], times[-1]) if times[0] < times[-1] else (times[0], times[0] + 1)
    path = Trajectory(
        jnp.linspace(first, last, len(stops)),
        jnp.stack([pose.quat for pose in poses]),
        jnp.stack([pose.translation for pose in poses]),
    )
    base = stops[0]
    return [
        (
            "ride",
            "test",
            Camera(base.film, base.lens, base.aperture, base.shutter, path, jnp.asarray(time)),
        )
        for time in np.linspace(first, last, steps).astype(np.float32)
    ]


def _film(film: Film, options: FilmOptions) -> Film:
    if options.filter == "keep":
        return film
    return Film(film.width, film.height, options.filter, options.width)


def _lens(camera: Camera, film: Film, options: LensOptions) -> AbstractLens:
    if options.model == "keep":
        return camera.lens
    size = np.array([film.width, film.height], np.float32)
    angle = np.deg2rad(options.fov)
    if options.model == "pinhole":
        if not 0 < options.fov < 180:
            raise ValueError(f"lens.fov must be in (0, 180) for a pinhole, got {options.fov}.")
        focal = size[0] / 2 / np.tan(angle / 2)
        return pinhole(jnp.full(2, focal, jnp.float32), jnp.asarray(size / 2))
    if options.model == "fisheye_polynomial":
        k = _coefficients(options.k, 5)
        lens = FisheyePolynomial(
            k,
            jnp.asarray(options.sensor, jnp.float32),
            jnp.asarray(size),
            jnp.zeros(2, jnp.float32),
            jnp.asarray(angle, jnp.float32),
        )
    elif options.model == "kannala_brandt":
        k = _coefficients(options.k, 4)
        half = angle / 2
        reach = half * (1 + sum(float(c) * half ** (2 * i + 2) for i, c in enumerate(k)))
        focal = jnp.full(2, size.min() / 2 / reach, jnp.float32)
        lens = KannalaBrandt(focal, jnp.asarray(size / 2), k, jnp.asarray(half, jnp.float32))
    else:
        raise ValueError(
            "lens.model must be keep, pinhole, fisheye_polynomial or kannala_brandt, "
            f"got {options.model!r}."
        )
    check_lens(lens, film.width, film.height)
    return lens


def _coefficients(k: tuple[float, ...], count: int):
    if len(k) != count:
        raise ValueError(f"lens.k must hold {count} coefficients, got {len(k)}.")
    return jnp.asarray(k, jnp.float32)


def _aperture(camera: Camera, options: ApertureOptions) -> Aperture:
    if options.radius == -1:
        return camera.aperture
    if options.radius == 0:
        return no_aperture()
    number = (options.radius, options.focus_distance, options.rotation, options.ratio)
    values = (jnp.asarray(x, jnp.float32) for x in number)
    return Aperture(*values, blades=options.blades, focus=options.focus)


def _shutter(camera: Camera, options: ShutterOptions) -> Shutter:
    if options.kind == "keep":
        return camera.shutter
    exposure = jnp.asarray(options.exposure, jnp.float32)
    if options.kind == "global":
        return global_shutter(exposure)
    if options.kind != "rolling":
        raise ValueError(f"shutter.kind must be keep, global or rolling, got {options.kind!r}.")
    across = options.direction in ("left_to_right", "right_to_left")
    rows = camera.film.width if across else camera.film.height
    step = options.readout / max(rows - 1, 1)
    offset, step = (jnp.asarray(x, jnp.float32) for x in (-options.readout / 2, step))
    return Shutter(offset, step, exposure, direction=options.direction)


def cameras_of(scene: Path | str, cameras: Path | str | None) -> list[View]:
    """The views of a capture, or those noted beside a reconstructed scene (cameras.json)."""
    if cameras is not None:
        folder = Path(cameras)
        if not folder.is_dir():
            return read_views(folder)
        name = format_of(folder)
        if name != "paired":
            return FORMATS[name](folder, jnp.float32).views
        return read_views(folder / PINHOLE_FILE)
    path = Path(scene)
    path = (path if path.is_dir() else path.parent) / "cameras.json"
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file. Name a capture's folder: cameras=DIR.")
    return read_views(path)
