"""Which cameras film a scene: a capture's, with lens, aperture, shutter or path exchanged."""

from collections.abc import Sequence
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from gaussray.camera.aperture import Aperture
from gaussray.camera.camera import Camera
from gaussray.camera.film import Film
from gaussray.camera.lens import AbstractLens
from gaussray.capture.capture import View
from gaussray.capture.formats.paired import read_cameras
from gaussray.capture.formats.transforms import PINHOLE_FILE
from gaussray.capture.open import FORMATS, format_of
from gaussray.dataset.manifest import FrameRecord
from gaussray.render.rig.exposure import (
    ApertureOptions as ApertureOptions,
    ShutterOptions as ShutterOptions,
    aperture_of,
    delays,
    rolls,
    shutter_of,
)
from gaussray.render.rig.lens import LensOptions as LensOptions, lens_label, mounted
from gaussray.render.rig.trajectory import TrajectoryOptions as TrajectoryOptions, moved


class CameraOptions(eqx.Module):
    """Which of the capture's cameras: by `names` (all of `split` if empty), at which `times` (all
    if empty)."""

    split: str = eqx.field(static=True, default="test")
    names: tuple[str, ...] = eqx.field(static=True, default=())
    times: tuple[float, ...] = eqx.field(static=True, default=())


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
    chosen = moved(_chosen(views, options.camera), options.trajectory)
    changed = {
        lens_label(options.lens): bool(lens_label(options.lens)),
        "depth_of_field": options.aperture.radius > 0,
        "rolling_shutter": rolls(options.shutter),
        "interlaced": options.shutter.kind == "interlaced",
        "motion_blur": options.shutter.kind != "keep" and options.shutter.exposure > 0,
    }
    effect = "_".join(name for name, on in changed.items() if on) or "pinhole"
    records, lenses = [], {}
    late = delays(options.shutter, list(dict.fromkeys(name for name, _, _ in chosen)))
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
            shutter_of(camera, options.shutter, late.get(name)),
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


def _film(film: Film, options: FilmOptions) -> Film:
    if options.filter == "keep":
        return film
    return Film(film.width, film.height, options.filter, options.width)


def _aperture(camera: Camera, lens: AbstractLens, options: ApertureOptions) -> Aperture:
    if options.radius > 0 and options.focus == "plane" and lens.sees_sideways:
        raise ValueError(
            "aperture.focus must be sphere for a lens that sees 90 degrees aside and beyond, where "
            "no plane in front is met, got plane."
        )
    return aperture_of(camera, options)


def cameras_of(scene: Path | str, cameras: Path | str | None) -> list[View]:
    """The views of a capture, or those noted beside a reconstructed scene (cameras.json)."""
    if cameras is not None:
        folder = Path(cameras)
        if not folder.is_dir():
            return read_cameras(folder)
        name = format_of(folder)
        if name != "paired":
            return FORMATS[name](folder, jnp.float32).views
        return read_cameras(folder / PINHOLE_FILE)
    path = Path(scene)
    path = (path if path.is_dir() else path.parent) / "cameras.json"
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file. Name a capture's folder: cameras=DIR.")
    return read_cameras(path)
