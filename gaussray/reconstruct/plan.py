"""What is fitted, and how: the pictures that count, the options, the model of motion, the segments.

Where options are left open, device and capture decide (`auto.choice`), and short fits (trials).
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

from gaussray.capture.capture import Capture
from gaussray.io.atomic import remove_partial_files
from gaussray.reconstruct.auto.choice import auto_choice
from gaussray.reconstruct.auto.machine import this_machine
from gaussray.reconstruct.auto.motion_choice import choices_to_try, with_motion_tried
from gaussray.reconstruct.auto.refinement_trial import with_refinement_tried
from gaussray.reconstruct.auto.trial_fits import Fitted, TrialFits, remove_killed_trials
from gaussray.reconstruct.auto.trial_part import trial_part
from gaussray.reconstruct.checks.covered_cameras import without_covered_cameras
from gaussray.reconstruct.checks.failed_fit import warn_of_one_place
from gaussray.reconstruct.data.common_times import common_times_sentence, with_common_times
from gaussray.reconstruct.data.segments import Segment, segments
from gaussray.reconstruct.options import ReconstructOptions
from gaussray.reconstruct.shared_results import SharedResults
from gaussray.runtime.devices import is_primary
from gaussray.runtime.progress import tell


class FitPlan(NamedTuple):
    """What is fitted, and how.

    Args:
        capture: the pictures, as large as they are fitted.
        unscaled: the same pictures, as large as they were given.
        scale: of the sides of the fitted ones, at most 1.
        options: all options, with what device, capture and trials decided.
        segments: the segments.
        shared: what trials found out of the first segment, for its fit.
        scores: PSNR of each model of motion that a trial compared; empty without one.
    """

    capture: Capture
    unscaled: Capture
    scale: float
    options: ReconstructOptions
    segments: list[Segment]
    shared: SharedResults
    scores: dict[str, float]


def fit_plan(
    capture: Capture,
    options: ReconstructOptions,
    out: Path,
    fit: Fitted,
    *,
    resume: bool,
    devices: int | None,
    quiet: bool,
) -> FitPlan:
    """Decide what is fitted, and how, and tell it.

    Args:
        capture: pictures and cameras, as recorded.
        options: the options as set.
        out: folder of the run, where scores of trials are kept.
        fit: how a segment is fitted, for trials.
        resume: whether scores that an interrupted run found are used.
        devices: how many devices of every host share the rays of a step; None for all.
        quiet: whether nothing is told.
    """
    say = partial(tell, quiet=quiet)
    recorded = without_covered_cameras(capture, quiet=quiet)
    capture = with_common_times(recorded)
    machine = this_machine(devices)
    chosen = auto_choice(capture, options, machine)
    candidates = choices_to_try(capture, options, machine, chosen.candidates)
    # A trial compares the same pictures, the smallest that one of its fits would take.
    tried = min((chosen, *candidates.values()), key=lambda choice: choice.scale)
    warn_of_one_place(capture)
    parts = segments(tried.capture, options.fit.segment)
    if is_primary():
        remove_partial_files(out, deep=len(parts) > 1)
        remove_killed_trials(out)
    say(common_times_sentence(recorded, capture))
    at_once, shared = machine.runs_two_fits, SharedResults()
    fits = TrialFits(tried.capture, parts[0], out, fit, shared, devices, quiet, at_once=at_once)
    # Rigid bodies are searched for at every time, other motion at a few.
    tracks = "deformation" in candidates and not resume
    short = _of_trial_part(fits, options.fit.segment, say) if tracks else fits
    chosen, scores = with_motion_tried(
        short, chosen, candidates, steps=machine.trial_steps, resume=resume, say=say
    )
    # The pictures of a part make room for those of all times.
    del short
    say(chosen.sentence)
    if chosen.scale != tried.scale:
        parts = segments(chosen.capture, options.fit.segment)
        fits = replace(fits, capture=chosen.capture, segment=parts[0], shared=SharedResults())
    options = with_refinement_tried(fits, chosen.options, resume=resume, say=say)
    return FitPlan(chosen.capture, capture, chosen.scale, options, parts, fits.shared, scores)


def _of_trial_part(fits: TrialFits, most: int, say: Callable[[str], None]) -> TrialFits:
    """The same fits of the part of a long capture that a trial sees (`trial_part`), which share
    nothing with the fit of the whole; `most` is the largest number of times of a segment."""
    part = trial_part(fits.capture, quiet=fits.quiet)
    if part is fits.capture:
        return fits
    first, last = part.time_range
    say(f"The trial sees successive times alone, from {first:g} to {last:g}: most moves there.")
    return replace(fits, capture=part, segment=segments(part, most)[0], shared=SharedResults())
