"""A trial of what shows what moves best: short fits without some pictures, which then decide.

Rigid bodies with a field are better at rigid things of which surface points are known, transient
Gaussians, with control points or without, at all others. What a capture holds is not known before.
So both are fitted for a short time without some pictures, and what shows the moving pixels of these
better is taken. Still pixels do not count: the two choices differ in how they fit what stands
still, too.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
from jaxtyping import Bool

from gaussray.reconstruct.auto.trial_fits import TrialFits
from gaussray.reconstruct.data.motion_mask import Activity, moved_in_tiles
from gaussray.reconstruct.data.pictures import Footage
from gaussray.reconstruct.data.tiles import cut, tile_pixels
from gaussray.reconstruct.held_out import held_out_score
from gaussray.reconstruct.optimize.state import State
from gaussray.reconstruct.options import ReconstructOptions
from gaussray.reconstruct.session import Session
from gaussray.runtime.side_by_side import run_side_by_side


# Cameras from which on one of them is held out at each time, so many of them in turn.
ENOUGH_CAMERAS, _IN_TURN = 5, 4
# Of fewer cameras, squares of so many pixels are held out, one of so many.
_SQUARE, _OF = 32, 4


def motion_tiles(footage: Footage, share: float, seed: int) -> Bool[np.ndarray, "frames tiles"]:
    """Which tiles a trial holds out: at each time those of another of four cameras, or, of few
    cameras, of squares that cover a quarter of each picture.

    Args:
        footage: the training pictures.
        share: unused; `HoldOut` asks for it.
        seed: of the choice of squares.
    """
    names = np.unique(footage.name)
    held = np.zeros(footage.pixel.shape[:2], bool)
    if len(names) >= ENOUGH_CAMERAS:
        chosen = [names[int((k + 0.5) * len(names) / _IN_TURN)] for k in range(_IN_TURN)]
        _, time = np.unique(footage.times, return_inverse=True)
        held[footage.name == np.array(chosen)[time % _IN_TURN]] = True
    else:
        pixels = tile_pixels(footage.film, footage.side, footage.bundle)
        rows, columns = (-(-n // _SQUARE) for n in (footage.film.height, footage.film.width))
        dice = np.random.default_rng([seed, 4])
        for frame in range(len(held)):
            square = dice.random((rows, columns)) < 1 / _OF
            every = np.kron(square, np.ones((_SQUARE, _SQUARE), bool))
            picture = every[: footage.film.height, : footage.film.width]
            held[frame] = cut(picture, pixels).any(axis=-1)
    visible = footage.visible_tiles()
    return held if visible is None else held & visible


def motion_trial_scores(
    fits: TrialFits, candidates: Mapping[str, ReconstructOptions], steps: Callable[[str], int]
) -> dict[str, float]:
    """PSNR in dB of the pixels that move in what is held out (of all where none does; 0 of a fit
    that failed), for every choice of `fit.motion` and its options; nothing where no tile can be
    held out.

    Args:
        fits: makes the short fits.
        candidates: the options of each choice of fit.motion.
        steps: steps of the fine stage of each choice (`Machine.trial_steps`).
    """

    def score_of(name: str) -> float | None:
        options = candidates[name]
        short = replace(options.fit, minutes=0.0, fine=steps(name), refine=())
        tried = replace(options, fit=short)
        return fits.score(name, tried, motion_tiles, moving_score)

    works = [partial(score_of, name) for name in candidates]
    found = run_side_by_side(works) if fits.at_once else [work() for work in works]
    scores = {
        name: score for name, score in zip(candidates, found, strict=True) if score is not None
    }
    return scores if len(scores) == len(candidates) else {}


def trial_sentence(scores: Mapping[str, float], nouns: Mapping[str, str]) -> str:
    """A line that tells how a trial ended.

    Args:
        scores: PSNR in dB of every choice of fit.motion (`motion_trial_scores`), at least one.
        nouns: what to call each choice.
    """
    best = max(scores, key=lambda name: scores[name])
    others = [f"{nouns[name]} {scores[name]:.1f} dB" for name in scores if name != best]
    return (
        f"Trial on moving pixels that were held out: {nouns[best]} {scores[best]:.1f} dB, "
        f"{', '.join(others)}; fit.motion={best}."
    )


def moving_score(session: Session, state: State) -> float:
    """PSNR in dB of the moving pixels of the tiles that a session holds out; of all their pixels
    where none moves.

    Args:
        session: a session that holds out tiles.
        state: what is scored.
    """
    held, seen = session.held_out, moving_alone(session.footage, session.activity)
    moving = seen.visible_tiles()
    assert held is not None and moving is not None
    if not (held & moving).any():
        return held_out_score(session, state)
    return held_out_score(session, state, seen, held & moving)


def moving_alone(footage: Footage, activity: Activity) -> Footage:
    """The same pictures, of which only the pixels count that differ from the temporal median.

    Args:
        footage: the training pictures.
        activity: their temporal medians (`activity`).
    """
    mask = []
    # One after another: a bit for each pixel takes an eighth of the memory.
    for frame in range(len(footage.pixel)):
        counts, visible = moved_in_tiles(footage, activity, [frame])[0], footage.visible(frame)
        mask.append(np.packbits(counts if visible is None else counts & visible, axis=-1))
    return replace(footage, mask=np.stack(mask))
