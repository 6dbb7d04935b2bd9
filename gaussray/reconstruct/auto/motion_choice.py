"""What shows what moves: the choice that a trial finds best, and the scores that it leaves."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from gaussray.capture.capture import Capture
from gaussray.io.atomic import write_json
from gaussray.reconstruct.auto.choice import MOTION_NOUNS, AutoChoice, auto_choice
from gaussray.reconstruct.auto.machine import Machine
from gaussray.reconstruct.auto.motion_trial import motion_trial_scores, trial_sentence
from gaussray.reconstruct.auto.trial_fits import TrialFits
from gaussray.reconstruct.options import ReconstructOptions
from gaussray.runtime.devices import is_primary


_FILE = "motion.json"


def choices_to_try(
    capture: Capture, options: ReconstructOptions, machine: Machine, names: Sequence[str]
) -> dict[str, AutoChoice]:
    """What is chosen for the capture with each of several choices of fit.motion.

    Args:
        capture: the capture.
        options: the options as set.
        machine: what the steps will run on.
        names: the choices (`AutoChoice.candidates`).
    """
    return {
        name: auto_choice(capture, replace(options, fit=replace(options.fit, motion=name)), machine)
        for name in names
    }


def with_motion_tried(
    fits: TrialFits,
    chosen: AutoChoice,
    candidates: Mapping[str, AutoChoice],
    *,
    steps: Callable[[str], int],
    resume: bool,
    say: Callable[[str], None] = lambda line: None,
) -> tuple[AutoChoice, dict[str, float]]:
    """The choice of fit.motion that a trial finds best, and its scores by choice.

    Where there is nothing to try, it is what was chosen already, without scores.

    Args:
        fits: makes the short fits, in the folder of the run, which gets motion.json.
        chosen: what was chosen without a trial.
        candidates: what is chosen with each choice that a trial must tell apart (`choices_to_try`).
        steps: steps of the fine stage of each choice (`Machine.trial_steps`).
        resume: whether the run goes on: then by the scores of its own trial.
        say: gets lines on what is tried, and what is best.
    """
    known = fits.out / _FILE
    if resume:
        scores = json.loads(known.read_text()) if known.is_file() else {}
    else:
        scores = {}
        if candidates:
            names = " or ".join(candidates)
            say(
                "Trial: short fits, each scored on pictures that it did not see, choose the model "
                "of motion. That takes some minutes, which fit.minutes does not count; "
                f"fit.motion={names} leaves it out."
            )
            tried = {name: candidate.options for name, candidate in candidates.items()}
            scores = motion_trial_scores(fits, tried, steps)
        if is_primary():
            known.unlink(missing_ok=True)
            if scores:
                write_json(known, scores)
    best = max(scores, key=lambda name: scores[name], default="")
    if best not in candidates:
        return chosen, {}
    say(trial_sentence(scores, MOTION_NOUNS))
    return candidates[best], scores
