"""fit=auto: how much work a capture is worth on this machine.

Steps, tiles, Gaussians, harmonics and the size of the pictures follow from the device, the number
and size of the training pictures and `fit.minutes`. What the user sets stays as set
(but fit.minutes where numbers of steps hold).
"""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import numpy as np

from gaussray.capture.capture import Capture, View, viewpoints
from gaussray.capture.selection import Selection, selected
from gaussray.reconstruct.auto.machine import Machine
from gaussray.reconstruct.auto.motion_trial import ENOUGH_CAMERAS
from gaussray.reconstruct.auto.picture_scale import picture_scale, pixel_count
from gaussray.reconstruct.auto.presets import (
    body_preset,
    for_few_viewpoints,
    from_rest_preset,
    still_preset,
    transient_preset,
)
from gaussray.reconstruct.data.segments import training_views
from gaussray.reconstruct.data.still_cameras import one_at_a_time
from gaussray.reconstruct.options import FitOptions, ReconstructOptions
from gaussray.runtime.output import counted, minutes_text


MOTION_NOUNS = {
    "deformation": "rigid bodies and a deformation field",
    "transient": "transient Gaussians",
    "both": "rigid bodies, a deformation field and transient Gaussians",
    "control_points": "control points, a deformation field and transient Gaussians",
    "from_rest": "control points that begin at rest and a deformation field",
}


# Pictures of a rig taken within so many seconds, one by each camera, are of one moment: as long as
# from one picture to the next of a video of 10 a second.
_ONE_SHOT = 0.1


class AutoChoice(NamedTuple):
    """Capture and options of a fit, a sentence about what was chosen, the choices of fit.motion
    of which a trial must tell which is best (none, or the chosen one and others), and the scale of
    the capture's pictures."""

    capture: Capture
    options: ReconstructOptions
    sentence: str
    candidates: tuple[str, ...] = ()
    scale: float = 1.0


def auto_choice(capture: Capture, options: ReconstructOptions, machine: Machine) -> AutoChoice:
    """What fit=auto chooses for a capture; without fit.auto, capture and options as they are.

    Args:
        capture: the capture, of which the training views count.
        options: the options as set; what differs from its default stays, as do `explicit_keys`.
        machine: what the steps will run on.
    """
    if not options.fit.auto:
        return AutoChoice(capture, options, "")
    views = training_views(capture)
    alike = len({view.time for view in views}) == 1
    if _is_set(options, "fit.tiles"):
        # Several GPUs share these tiles: each has fewer, and the rates are those of one.
        machine = machine._replace(gpus=1)
    names = ("none",) if alike else motions(capture, options, machine)
    still = names == ("none",)
    given = _is_set(options, "fit.coarse") or _is_set(options, "fit.fine")
    minutes = machine.minutes_for(pixel_count(views), still=still)
    # A GPU has the memory for so many pixels; on a CPU, bodies are fitted by numbers of steps.
    timed = not (given or machine.gpu or names[0] == "deformation")
    longer = max(options.fit.minutes / minutes, 1.0) if timed else 1.0
    scale, size = picture_scale(views, machine, names[0], longer), ""
    if scale < 1:
        capture = selected(capture, Selection(scale=scale))
        views = training_views(capture)
        # They would take as many times as long as they have pixels.
        size = _size(views[0], scale, minutes * longer / scale**2 if timed else 0.0)
    pixels = pixel_count(views)
    if still:
        chosen = still_preset(pixels, minutes, machine)
        if not alike:
            chosen = replace(chosen, fit=replace(chosen.fit, motion="none"))
    elif names[0] == "deformation":
        chosen = body_preset(pixels, machine, options.track, given=_given(capture, options.fit))
    elif names[0] == "from_rest":
        chosen = from_rest_preset(pixels, minutes, machine)
    else:
        chosen = transient_preset(pixels, minutes, machine, names[0])
    chosen = for_few_viewpoints(chosen, len(set(viewpoints(views))), machine)
    if _is_set(options, "density.opacity_cost"):
        # The pictures, which are read later, do not change what is set.
        explicit = (*options.explicit_keys, "density.opacity_cost")
        options = replace(options, explicit_keys=explicit)
    options = with_defaults(options, chosen)
    if given or not chosen.fit.minutes:
        options = replace(options, fit=replace(options.fit, minutes=0.0))
    # A fit that is shorter than a trial is worth none.
    long = options.fit.minutes > 0 or options.fit.fine >= machine.trial_steps(names[0])
    candidates = names if len(names) > 1 and long else ()
    sentence = _sentence(options, len(views), size, still)
    return AutoChoice(capture, options, sentence, candidates, scale)


def _is_set(options: ReconstructOptions, key: str) -> bool:
    """Whether a value was set: it differs from its default, or is among `explicit_keys`."""
    part, name = key.split(".")
    value, default = (getattr(getattr(o, part), name) for o in (options, ReconstructOptions()))
    return value != default or key in options.explicit_keys


def with_defaults(options: ReconstructOptions, chosen: ReconstructOptions) -> ReconstructOptions:
    """The options, with others in place of those that were not set.

    Args:
        options: the options as set; what differs from its default stays, and so do
            `explicit_keys`, unless a value says that it is to be chosen (`auto`, no minutes).
        chosen: the options to take where a default stands.
    """
    usual = ReconstructOptions()

    def merged(part: str) -> eqx.Module:
        given, default, other = (getattr(one, part) for one in (options, usual, chosen))
        values = {field.name: getattr(given, field.name) for field in dataclasses.fields(given)}
        stays = {
            name: value
            for name, value in values.items()
            if value != getattr(default, name)
            or f"{part}.{name}" in options.explicit_keys
            and not (value == "auto" or name == "minutes")
        }
        return replace(other, **stays)

    return replace(options, **{part: merged(part) for part in _CHOSEN})


_CHOSEN = ("fit", "loss", "optimizer", "density", "trace", "track")


def motions(capture: Capture, options: ReconstructOptions, machine: Machine) -> tuple[str, ...]:
    """The choices of fit.motion that may suit a capture of several times best, the likeliest first.

    Rigid bodies are found by cameras that stand still, on surface points: given ones, or, on a GPU,
    those of stereo. Whether stereo has found enough of them, only a trial tells that can spare a
    camera (`motion_trial.ENOUGH_CAMERAS`). A trial tells, too, whether they are better than
    transient Gaussians, which as many cameras help to follow surfaces (control points). On a CPU,
    bodies on stereo's points were worse, so it tries control points beside them instead. Where most
    times have a single picture, transient Gaussians suit a camera that moves along a path; one that
    jumps from place to place needs Gaussians that all times share, on control points that begin at
    rest. That nothing moves, the user alone knows: of a camera on its way each picture shows what
    others do not. One picture of each camera of a rig, at nearly the same time, shows no motion.

    Args:
        capture: the capture, of which training views and points count.
        options: the options as set; a fit.motion other than auto is the only choice.
        machine: what the steps will run on.
    """
    fit, views = options.fit, training_views(capture)
    if fit.motion != "auto":
        return (fit.motion,)
    if one_at_a_time(np.array([view.time for view in views])):
        if _one_shot(views, capture.time_unit):
            return ("none",)
        return ("transient",) if _along_a_path(views) else ("from_rest",)
    still = _still_cameras(views)
    if still >= 2:
        given, stereo = _given(capture, fit), fit.start in ("auto", "stereo")
        followed = still >= ENOUGH_CAMERAS and (given or stereo)
        soft = "control_points" if machine.gpu and followed else "transient"
        if given:
            return ("deformation", soft)
        if not followed:
            return (soft,)
        return (soft, "deformation" if machine.gpu else "control_points")
    _, at_once = np.unique([view.time for view in views], return_counts=True)
    many = 2 * int(np.sum(at_once >= ENOUGH_CAMERAS)) > len(at_once)
    return ("control_points",) if many and machine.gpu else ("transient",)


def _given(capture: Capture, fit: FitOptions) -> bool:
    """Whether the fit begins on given points, and there are enough of them."""
    points = capture.points if fit.start in ("auto", "given") else None
    return points is not None and len(points.position) >= fit.points


def _still_cameras(views: Sequence[View]) -> int:
    """How many cameras took three or more pictures from where they stand."""
    _, pictures = np.unique(viewpoints(views), return_counts=True)
    return int(np.sum(pictures >= 3))


def _one_shot(views: Sequence[View], unit: str) -> bool:
    """Whether each of several cameras took one picture, all at nearly the same time: a rig whose
    cameras are triggered one after another."""
    times = [view.time for view in views]
    each = len({view.camera_name for view in views}) == len(views)
    return unit == "seconds" and each and bool(np.ptp(times) <= _ONE_SHOT)


def _along_a_path(views: Sequence[View]) -> bool:
    """Whether pictures that follow one another were taken close to each other, as those of a video
    are: at less than half of the spread of all places, in the median."""
    eye = np.array([view.camera.trajectory.translation[0] for view in views])
    eye = eye[np.argsort([view.time for view in views], kind="stable")]
    step = np.median(np.linalg.norm(np.diff(eye, axis=0), axis=1))
    return bool(step < 0.5 * np.sqrt(np.sum(np.var(eye, axis=0))))


def _size(view: View, scale: float, enough: float) -> str:
    """What is said of scaled pictures, with the fit.minutes that keep their size (0: none do)."""
    text = f"scaled by {scale:.2f} to {view.width} x {view.height}"
    remedy = f" (fit.minutes={math.ceil(enough)} keeps their size)"
    return text + remedy if enough else text


def _sentence(options: ReconstructOptions, count: int, size: str, still: bool) -> str:
    fit, parts = options.fit, [f"fit=auto: {counted(count, 'picture')}"]
    if size:
        parts.append(size)
    if still or options.density.relocates:
        most = max(options.density.gaussians, fit.points)
        parts.append(f"up to {most:,} Gaussians, or all starting points if these are more")
        parts.append(f"harmonics up to degree {fit.degree}")
    if fit.motion == "none":
        parts.append("nothing moves (fit.motion=none)")
    elif not still:
        parts.append(f"motion by {MOTION_NOUNS[fit.motion]} (fit.motion)")
    if fit.minutes:
        parts.append(f"about {minutes_text(fit.minutes)} of steps (fit.minutes)")
        return f"{', '.join(parts)}; reading, stereo and compilation take extra time."
    elif still:
        steps = fit.coarse + fit.fine
        parts.append(counted(steps, "step"))
    else:
        parts.append(f"{fit.coarse} + {fit.fine} steps")
    return ", ".join(parts) + "."
