"""What shows what moves: the choice that a trial finds best, and the scores that it leaves."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from gaussray.capture.capture import Capture
from gaussray.io.atomic import write_json
from gaussray.reconstruct.auto.effort import MOTION_NOUNS, Effort, effort
from gaussray.reconstruct.auto.machine import Machine
from gaussray.reconstruct.auto.motion_trial import motion_trial_scores, trial_sentence
from gaussray.reconstruct.auto.trial_fits import TrialFits
from gaussray.reconstruct.options import ReconstructOptions
from gaussray.runtime.devices import leads


_FILE = "motion.json"


def rivals_of(
    capture: Capture, options: ReconstructOptions, machine: Machine, names: Sequence[str]
) -> dict[str, Effort]:
    """What is chosen for the capture with each of several choices of fit.motion.

    Args:
        capture: the capture.
        options: the options as set.
        machine: what the steps will run on.
        names: the choices (`Effort.rivals`).
    """
    return {
        name: effort(capture, replace(options, fit=replace(options.fit, motion=name)), machine)
        for name in names
    }


def with_motion_tried(
    fits: TrialFits,
    chosen: Effort,
    rivals: Mapping[str, Effort],
    *,
    steps: Callable[[str], int],
    resume: bool,
    say: Callable[[str], None] = lambda line: None,
) -> tuple[Effort, dict[str, float]]:
    """The choice of fit.motion that a trial finds best, and its scores by choice.

    Where there is nothing to try, it is what was chosen already, without scores.

    Args:
        fits: makes the short fits, in the folder of the run, which gets motion.json.
        chosen: what was chosen without a trial.
        rivals: what is chosen with each choice that a trial must tell apart (`rivals_of`).
        steps: steps of the fine stage of each choice (`Machine.trial_steps`).
        resume: whether the run goes on: then by the scores of its own trial.
        say: gets lines on what is tried, and what is best.
    """
    known = fits.out / _FILE
    if resume:
        scores = json.loads(known.read_text()) if known.is_file() else {}
    else:
        scores = {}
        if rivals:
            say(
                "Trial: short fits, each scored on pictures that it did not see, choose the model "
                "of motion (fit.motion)."
            )
            tried = {name: rival.options for name, rival in rivals.items()}
            scores = motion_trial_scores(fits, tried, steps)
        if leads():
            known.unlink(missing_ok=True)
            if scores:
                write_json(known, scores)
    best = max(scores, key=lambda name: scores[name], default="")
    if best not in rivals:
        return chosen, {}
    say(trial_sentence(scores, MOTION_NOUNS))
    return rivals[best], scores
