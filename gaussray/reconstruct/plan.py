"""What is fitted, and how: the pictures that count, the options, the model of motion, the segments.

Where options are left open, device and capture decide (`auto.effort`), and short fits (trials).
"""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

from gaussray.capture.capture import Capture
from gaussray.io.atomic import sweep
from gaussray.reconstruct.auto.effort import effort
from gaussray.reconstruct.auto.machine import this_machine
from gaussray.reconstruct.auto.motion_choice import rivals_of, with_motion_tried
from gaussray.reconstruct.auto.refinement_trial import with_refinement_tried
from gaussray.reconstruct.auto.trial_fits import Fitted, TrialFits, remove_killed_trials
from gaussray.reconstruct.checks.covered_cameras import without_covered_cameras
from gaussray.reconstruct.checks.failed_fit import warn_of_one_place
from gaussray.reconstruct.data.common_times import common_times_sentence, with_common_times
from gaussray.reconstruct.data.segments import Segment, segments
from gaussray.reconstruct.options import ReconstructOptions
from gaussray.reconstruct.shared_results import SharedResults
from gaussray.runtime.devices import leads
from gaussray.runtime.progress import tell


class FitPlan(NamedTuple):
    """What is fitted, and how.

    Args:
        capture: the pictures, as large as they are fitted.
        options: all options, with what device, capture and trials decided.
        course: the segments.
        shared: what trials found out of the first segment, for its fit.
        scores: PSNR of each model of motion that a trial compared; empty without one.
    """

    capture: Capture
    options: ReconstructOptions
    course: list[Segment]
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
    chosen = effort(capture, options, machine)
    rivals = rivals_of(capture, options, machine, chosen.rivals)
    # A trial compares the same pictures, the smallest that one of its fits would take.
    tried = min((chosen, *rivals.values()), key=lambda choice: choice.scale)
    warn_of_one_place(capture)
    course = segments(tried.capture, options.fit.segment)
    if leads():
        sweep(out, deep=len(course) > 1)
        remove_killed_trials(out)
    say(common_times_sentence(recorded, capture))
    at_once, shared = machine.runs_two_fits, SharedResults()
    fits = TrialFits(tried.capture, course[0], out, fit, shared, devices, quiet, at_once=at_once)
    chosen, scores = with_motion_tried(
        fits, chosen, rivals, steps=machine.trial_steps, resume=resume, say=say
    )
    say(chosen.sentence)
    if chosen.scale != tried.scale:
        course = segments(chosen.capture, options.fit.segment)
        fits = replace(fits, capture=chosen.capture, segment=course[0], shared=SharedResults())
    options = with_refinement_tried(fits, chosen.options, resume=resume, say=say)
    return FitPlan(chosen.capture, options, course, fits.shared, scores)
