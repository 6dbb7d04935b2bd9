"""Which cameras film a scene: a capture's, with lens, aperture, shutter or path exchanged."""

from collections.abc import Sequence
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from gaussray.camera.camera import Camera
from gaussray.camera.film import Film
from gaussray.camera.lens import (
    AbstractLens,
    FisheyePolynomial,
    KannalaBrandt,
    check_lens,
    pinhole,
)
from gaussray.capture.calibration import PINHOLE_FILE, View, read_views
from gaussray.capture.formats import FORMATS, format_of
from gaussray.dataset.manifest import FrameRecord
from gaussray.exposure import (
    ApertureOptions as ApertureOptions,
    ShutterOptions as ShutterOptions,
    aperture_of,
    delays,
    rolls,
    shutter_of,
)
from gaussray.journey import TrajectoryOptions as TrajectoryOptions, moved


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
        "fisheye": options.lens.model not in ("keep", "pinhole"),
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
            lenses[size] = _lens(camera, film, options.lens)
        built = Camera(
            film,
            lenses[size],
            aperture_of(camera, options.aperture),
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
