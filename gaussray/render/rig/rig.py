"""The cameras of a render: a capture's, with another lens, aperture, shutter or trajectory."""

import difflib
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from gaussray.camera.camera import Camera, check_focus
from gaussray.camera.lens import AbstractLens
from gaussray.capture.capture import View
from gaussray.dataset.manifest import FrameRecord
from gaussray.io.plain_values import to_device
from gaussray.render.rig.aperture import (
    ApertureOptions as ApertureOptions,
    build_aperture,
    resolve_aperture,
)
from gaussray.render.rig.effect_name import effect_name
from gaussray.render.rig.film import FilmOptions as FilmOptions, apply_film
from gaussray.render.rig.lens import LensOptions as LensOptions, build_lens
from gaussray.render.rig.neighbours import moved_frames
from gaussray.render.rig.placed import CameraOptions as CameraOptions
from gaussray.render.rig.shutter import (
    ShutterOptions as ShutterOptions,
    build_shutter,
    trigger_delays,
)
from gaussray.render.rig.trajectory import TrajectoryOptions as TrajectoryOptions
from gaussray.runtime.output import listed_names


# Times (the capture's unit) that differ by less are equal; and the share of the time between two
# frames by which a given time may be off that of a frame.
_SAME_TIME, _SAME_FRAME = 1e-6, 0.1
# Cameras that a message names.
_NAMED = 10


class RigOptions(eqx.Module):
    """All options of the cameras of a render, one class per group of conf/."""

    camera: CameraOptions = eqx.field(default_factory=CameraOptions)
    lens: LensOptions = eqx.field(default_factory=LensOptions)
    aperture: ApertureOptions = eqx.field(default_factory=ApertureOptions)
    shutter: ShutterOptions = eqx.field(default_factory=ShutterOptions)
    trajectory: TrajectoryOptions = eqx.field(default_factory=TrajectoryOptions)
    film: FilmOptions = eqx.field(default_factory=FilmOptions)


def frame_records(
    views: Sequence[View],
    *,
    options: RigOptions,
    samples: int,
    format: str = "png",
    measure: Callable[[Camera, str], float] | None = None,
    within: tuple[float, float] | None = None,
) -> list[FrameRecord]:
    """The frames to render, each with its camera and the path of its picture.

    They follow the order of `camera.names`; without, that of the capture. The pictures are numbered
    in the order of the capture in either case.

    Args:
        views: the views of a capture.
        options: which of them to render, and what to change about their cameras.
        samples: rays per pixel, for the record.
        format: file format of the pictures: png (8-bit sRGB) or exr (linear light).
        measure: measures the distance that `aperture.focus_distance=auto` stands for, at a camera
            and for a kind of focus ("plane" or "sphere"). It is called at most once, for the first
            frame's camera. None where all lengths of the aperture are numbers.
        within: first and last time of the scene, between which the only frame of a camera has the
            capture's frames before and after it as neighbours (`moved_frames`). None: it has none.

    Raises:
        ValueError: The options choose no frame, or no camera can be built from them.
    """
    if format not in ("png", "exr"):
        raise ValueError(f"format must be png (sRGB) or exr (linear light), got {format!r}.")
    chosen = choose_views(views, options)
    numbers, own = [number for number, _ in chosen], [view for _, view in chosen]
    frames, near = moved_frames(
        views, own, options.trajectory, names=options.camera.names, within=within
    )
    effect = effect_name(
        [camera for _, _, camera in frames], options.lens, options.aperture, options.shutter
    )
    delays = trigger_delays(options.shutter, list(dict.fromkeys(name for name, _, _ in frames)))
    lenses: dict[tuple[int, int], AbstractLens] = {}

    def equipped(name: str, camera: Camera) -> Camera:
        return _equipped(camera, options, lenses, delays.get(name))

    cameras = [equipped(name, camera) for name, _, camera in frames]
    aperture = options.aperture
    if measure is not None:
        aperture = resolve_aperture(aperture, partial(measure, cameras[0], aperture.focus))
    neighbours = {}
    for name, pair in near.items():
        before, after = (one and _with_aperture(equipped(name, one), aperture) for one in pair)
        neighbours[name] = before, after
    return [
        FrameRecord(
            f"images/{effect}/{name}/{number:04d}.{format}",
            _with_aperture(camera, aperture),
            name,
            split,
            effect,
            samples,
            neighbours=neighbours.get(name),
        )
        for number, (name, split, _), camera in zip(
            numbers if options.trajectory.kind == "keep" else range(len(frames)),
            frames,
            cameras,
            strict=True,
        )
    ]


def _equipped(
    camera: Camera,
    options: RigOptions,
    lenses: dict[tuple[int, int], AbstractLens],
    delay: Float[Array, ""] | None,
) -> Camera:
    """The camera with the film, lens and shutter of the options."""
    camera = apply_film(camera, options.film)
    film = camera.film
    size = film.width, film.height
    if options.lens.model == "keep":
        lens = camera.lens
    else:
        # Frames of one size share their lens: building one takes a while.
        lens = lenses[size] = lenses.get(size) or build_lens(film, options.lens)
    return Camera(
        film,
        lens,
        camera.aperture,
        build_shutter(camera, options.shutter, delay),
        camera.trajectory,
        camera.time,
        clip_start=_clip_start(camera, options.camera),
    )


def choose_views(views: Sequence[View], rig: RigOptions) -> list[tuple[int, View]]:
    """The chosen views in the order of `camera.names`, each with its number among them in the order
    of the capture.

    Args:
        views: the views of the capture.
        rig: which of them are chosen.

    Raises:
        ValueError: The options choose no frame, or name what is not there.
    """
    options = rig.camera
    _check_repeated(options.names, rig.trajectory)
    names = list(dict.fromkeys(view.camera_name for view in views))
    listed = listed_names(names, most=_NAMED)
    for name in options.names:
        if name not in names:
            raise ValueError(
                f"camera.names must be among the capture's ({listed}), got {name}."
                f"{_alike(name, names)}"
            )
    split = options.split
    if split == "test" and not any(view.split == split for view in views):
        split = "train"  # a capture that holds out no camera
    of_cameras = [
        view
        for view in views
        if (view.camera_name in options.names if options.names else split in ("all", view.split))
    ]
    if of_cameras and options.times:
        times = np.array(_frame_times(of_cameras, options.times))
        of_cameras = [v for v in of_cameras if np.min(np.abs(times - v.time)) < _SAME_TIME]
    if not of_cameras:
        splits = list(dict.fromkeys(view.split for view in views)) or ["train"]
        raise ValueError(
            "camera.split, camera.names and camera.times choose no frame of the capture; its "
            f"cameras are {listed}, its splits {', '.join(splits)}. Choose e.g. "
            f"camera.split={splits[0]}."
        )
    place = {name: i for i, name in enumerate(dict.fromkeys(options.names))}
    numbered = list(enumerate(of_cameras))
    return sorted(numbered, key=lambda one: place.get(one[1].camera_name, 0))


def _check_repeated(names: Sequence[str], trajectory: TrajectoryOptions) -> None:
    """Refuse a camera that is named twice, unless a ride returns to it."""
    repeated = [name for name, count in Counter(names).items() if count > 1]
    if repeated and trajectory.kind != "between":
        raise ValueError(
            f"camera.names must name each camera once, got {repeated[0]} more than once. Only "
            "trajectory=between may return to a camera."
        )


def _alike(name: str, names: Sequence[str]) -> str:
    """A question that names the camera most like an unknown one; empty if none is like it."""
    alike = difflib.get_close_matches(str(name), names, n=1)
    return f" Did you mean {alike[0]}?" if alike else ""


def _frame_times(views: Sequence[View], given: Sequence[float]) -> list[float]:
    """The times of frames that are meant by given ones, which may be rounded."""
    times = np.unique([view.time for view in views])
    off = max(_SAME_FRAME * float(np.median(np.diff(times))) if len(times) > 1 else 0, _SAME_TIME)
    meant = []
    for time in given:
        distance = np.abs(times - time)
        nearest = np.argsort(distance)[:2]
        if not distance[nearest[0]] <= off:
            near = ", ".join(f"{t:.8g}" for t in np.sort(times[nearest]))
            raise ValueError(
                f"camera.times must be times of frames of the capture, got {time:g}; the nearest "
                f"are {near}. camera=look_at takes any time. To see this camera at others, change "
                "them in a copy of the run's cameras.json, and name it: cameras=COPY.json "
                "camera.split=all. Pictures then have the capture's own size; film.size=[W,H] "
                "sets another."
            )
        meant.append(float(times[nearest[0]]))
    return meant


def _with_aperture(camera: Camera, options: ApertureOptions) -> Camera:
    if options.radius is None:
        return camera
    aperture = build_aperture(camera, options)
    check_focus(aperture, camera.lens)
    return eqx.tree_at(lambda c: c.aperture, camera, aperture)


def _clip_start(camera: Camera, options: CameraOptions) -> Array | None:
    """Where the rays of a frame begin to see; None is at the lens."""
    if options.clip_start is None:
        return camera.clip_start
    return to_device(options.clip_start, camera.time.dtype) if options.clip_start else None
