"""A trial of which corrections of cameras help: short fits, scored on tiles that none draws.

A fit that is softer than its cameras are wrong has nothing to correct them with, and moves cameras
that were right. So a correction is kept only if pictures that it has not seen gain by it.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import replace

from gaussray.io.atomic import write_json
from gaussray.reconstruct.auto.trial_fits import TrialFits
from gaussray.reconstruct.data.held_out_tiles import trial_tiles
from gaussray.reconstruct.held_out import held_out_score
from gaussray.reconstruct.options import ReconstructOptions
from gaussray.runtime.devices import is_primary


# Steps of a stage of a trial, at most; and the share of the tiles that is held out.
_STEPS, _SHARE = 500, 0.05
# The scores of a trial, in the run's folder; a run that is resumed goes by them.
_FILE = "refine.json"


def kept_corrections(
    kinds: Sequence[str], score: Callable[[tuple[str, ...]], float], gain: float
) -> tuple[tuple[str, ...], dict[str, float]]:
    """Which corrections are kept: one after another, each beside those that are kept already.

    Args:
        kinds: the corrections, in order.
        score: PSNR in dB of held-out tiles with some corrections; 0 of a fit that failed.
        gain: dB that a correction must gain.

    Returns:
        Those that are kept, and the score with each, "" for the recorded cameras.
    """
    kept, scores = (), {"": score(())}
    best = scores[""]
    for kind in kinds:
        scores[kind] = score((*kept, kind))
        if scores[kind] >= best + gain:
            kept, best = (*kept, kind), scores[kind]
    return kept, scores


def with_refinement_tried(
    fits: TrialFits,
    options: ReconstructOptions,
    *,
    resume: bool,
    say: Callable[[str], None] = lambda line: None,
) -> ReconstructOptions:
    """The options with the corrections that help (`kept_corrections`), without any where no tile
    can be held out; the same options where nothing is refined.

    Args:
        fits: makes the short fits, in the folder of the run, which gets refine.json.
        options: the options; fit.refine names the corrections to try, fit.refine_gain the dB.
        resume: whether the run goes on: then by the scores of its own trial.
        say: gets lines on what is tried, and which corrections are kept.
    """
    known, kinds = fits.out / _FILE, options.fit.refine
    if not kinds or options.fit.refine_gain < 0:
        return options
    if resume:
        found = json.loads(known.read_text()) if known.is_file() else {"kept": kinds}
        return _with_refine(options, tuple(found["kept"]))
    say("Short fits tell by which corrections of cameras held-out tiles gain.")

    fit = options.fit
    short = replace(
        fit,
        minutes=0.0,
        coarse=min(fit.coarse, _STEPS),
        fine=min(fit.fine, _STEPS),
        validate=_SHARE,
    )

    def score(chosen: tuple[str, ...]) -> float | None:
        tried = replace(options, fit=replace(short, refine=chosen))
        name = ", ".join(chosen) or "recorded cameras"
        return replace(fits, quiet=True).score(name, tried, trial_tiles, held_out_score)

    recorded = score(())
    if recorded is None:
        if is_primary():
            write_json(known, {"kept": [], "psnr": {}})
        say(
            "Too few tiles to hold any out: cameras are left as recorded. "
            f"fit.refine_gain=-1 refines them unchecked ({', '.join(kinds)})."
        )
        return _with_refine(options, ())
    kept, scores = kept_corrections(
        kinds,
        lambda chosen: (score(chosen) or 0.0) if chosen else recorded,
        options.fit.refine_gain,
    )
    if is_primary():
        write_json(known, {"kept": list(kept), "psnr": scores})
    say(refinement_sentence(kept, scores))
    return _with_refine(options, kept)


def refinement_sentence(kept: Sequence[str], scores: dict[str, float]) -> str:
    """A line that tells which corrections were kept.

    Args:
        kept: the corrections that were kept.
        scores: PSNR in dB with each correction, "" for the recorded cameras (`kept_corrections`).
    """
    outcomes = [
        f"{kind} {value:.2f} dB ({'kept' if kind in kept else 'left as recorded'})"
        for kind, value in scores.items()
        if kind
    ]
    return f"Held-out tiles: recorded cameras {scores['']:.2f} dB, {', '.join(outcomes)}."


def _with_refine(options: ReconstructOptions, kinds: tuple[str, ...]) -> ReconstructOptions:
    return replace(options, fit=replace(options.fit, refine=kinds))
