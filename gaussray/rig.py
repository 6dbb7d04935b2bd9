"""Which cameras film a scene: a capture's, with lens, aperture, shutter or path exchanged."""

from collections.abc import Sequence
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from gaussray.camera.aperture import Aperture, no_aperture
from gaussray.camera.camera import Camera
from gaussray.camera.film import Film
from gaussray.camera.lens import AbstractLens
from gaussray.camera.shutter import Shutter, global_shutter
from gaussray.camera.trajectory import Trajectory, pose_at
from gaussray.capture.calibration import PINHOLE_FILE, View, read_views
from gaussray.capture.formats import FORMATS, format_of
from gaussray.dataset.manifest import FrameRecord
from gaussray.optics import LensOptions as LensOptions, lens_label, mounted, sees_aside


class CameraOptions(eqx.Module):
    """Which of the capture's cameras: by `names` (all of `split` if empty), at which `times` (all
    if empty)."""

    split: str = eqx.field(static=True, default="test")
    names: tuple[str, ...] = eqx.field(static=True, default=())
    times: tuple[float, ...] = eqx.field(static=True, default=())


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
        lens_label(options.lens): bool(lens_label(options.lens)),
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
            keep = options.lens.model == "keep"
            lenses[size] = camera.lens if keep else mounted(film, options.lens)
        built = Camera(
            film,
            lenses[size],
            _aperture(camera, lenses[size], options.aperture),
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


def _aperture(camera: Camera, lens: AbstractLens, options: ApertureOptions) -> Aperture:
    if options.radius == -1:
        return camera.aperture
    if options.radius == 0:
        return no_aperture()
    if options.focus == "plane" and sees_aside(lens):
        raise ValueError(
            "aperture.focus must be sphere for a lens that sees 90 degrees aside and beyond, where "
            "no plane in front is met, got plane."
        )
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
