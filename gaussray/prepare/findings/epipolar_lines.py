"""Whether matches lie on their epipolar lines: the test of poses, known or estimated."""

from collections.abc import Mapping, Sequence

import numpy as np

from gaussray.capture.odd_cameras import JudgedPair, odd_cameras
from gaussray.prepare.contradictions import (
    DOUBTFUL,
    contradicted_pictures,
    contradicting_pairs,
    strong_pairs,
)
from gaussray.prepare.epipolar import EpipolarPair
from gaussray.prepare.findings.calibration_readings import better_reading
from gaussray.prepare.findings.finding import Finding
from gaussray.prepare.findings.lens_advice import lens_advice
from gaussray.prepare.findings.pair_distances import (
    EVIDENCE,
    PairDistance,
    pair_distances,
    pairs_with_enough_matches,
)
from gaussray.prepare.placed_cameras import picture_name
from gaussray.prepare.placement import Placement


# Pixels, for each 1000 pixels of width, above which epipolar errors are doubtful or, with known
# cameras, show another calibration.
DOUBTFUL_LINES, WRONG_LINES = 3.0, 25.0
# A pair contradicts others if it is so many times as far off as these, and so many pixels.
_FARTHER, _LEAST = 3.0, 1.0
# Pairs of a camera that are listed, at most.
_LISTED = 4
_MOVED = (
    "Such a camera was moved or turned since the calibration, or its lens, zoom or picture size "
    "is another one: calibrate it again, or take its video away; fit.refine=[pose,lens] mends "
    "small errors."
)
_CORRECT = "Correct the calibration, or check the order of the cameras and their names."


def epipolar_findings(placement: Placement, pairs: Sequence[EpipolarPair]) -> list[Finding]:
    """Distances of matches from the epipolar lines; the test of a known calibration.

    All pairs tell whether single cameras, or pictures, contradict the others.

    Args:
        placement: poses and lenses, whether they come from a calibration, and matches.
        pairs: pairs of pictures; those with fewer than `EVIDENCE` matches do not count.
    """
    scale = max((lens["w"] for lens in placement.model.lenses), default=1000) / 1000
    tested = [pair for pair in pairs if np.isfinite(pair.median) and pair.count >= EVIDENCE]
    if not tested:
        text = "no two pictures share enough matches to test the poses"
        remedy = "Check by eye that the drawn lines pass through the same things, if there are any."
        return [Finding("warn", "epipolar lines", text, remedy)]
    typical = float(np.median([pair.median for pair in tested]))
    text = f"matches are {typical:.2f} pixels from their epipolar lines (median of the pairs)"
    doubtful = typical > DOUBTFUL_LINES * scale
    if not placement.known and not doubtful and (found := _misplaced(placement)):
        remedy = (
            "Look at where these stand (gaussray view). Larger pictures, or others between them "
            f"and their neighbours, find more matches; {lens_advice(placement)}; or take them away."
        )
        return [Finding("warn", "epipolar lines", f"{text}; {found}", remedy)]
    if placement.known and (
        cause := _cause(placement, max(DOUBTFUL_LINES * scale, _LEAST), doubtful)
    ):
        level = "refuse" if typical > WRONG_LINES * scale else "warn"
        found, remedy = cause
        return [Finding(level, "epipolar lines", f"{text}; {found}", remedy)]
    if typical > WRONG_LINES * scale and placement.known:
        remedy = (
            "The calibration is not of these pictures: check the order of the cameras, their "
            "names, zoom, and that no camera was moved since."
        )
        return [Finding("refuse", "epipolar lines", text, remedy)]
    if doubtful:
        if placement.known:
            text += "; compare the result without poses.calibration"
        remedy = "fit.refine=[pose,lens] may repair it; a new calibration is better."
        return [Finding("warn", "epipolar lines", text, remedy)]
    return [Finding("good", "epipolar lines", text)]


def _misplaced(placement: Placement) -> str:
    """The estimated poses that matches contradict; empty if there are none."""

    def called(file: str) -> str:
        return picture_name(placement.pictures[file], placement)

    pairs = strong_pairs(placement)
    texts = [
        f"those of {called(file)} {own:.2g} pixels, without it {rest:.2g}"
        for file, (own, rest) in contradicted_pictures(placement, pairs, DOUBTFUL).items()
    ]
    if not texts:
        texts = [
            f"those of {called(a)} and {called(b)} {distance:.2g} pixels: one of both is misplaced"
            for (a, b), distance in contradicting_pairs(placement, pairs).items()
        ]
    more = f"; and {len(texts) - _LISTED} more" if len(texts) > _LISTED else ""
    return "; ".join(texts[:_LISTED]) + more


def _cause(placement: Placement, limit: float, doubtful: bool) -> tuple[str, str] | None:
    """What explains matches that are off, and a remedy; None if nothing does, or none are.

    Args:
        placement: known poses and lenses, and matches.
        limit: largest distance in pixels that fits.
        doubtful: whether most pairs are off.
    """
    files, told = placement.model.pictures, pairs_with_enough_matches(placement)
    distances = pair_distances(placement, told)
    odd, words = _contradicting(placement, distances, limit)
    if odd:
        own = [pair for pair in told if set(pair) & set(odd)]
        other = better_reading(placement, own, odd, limit)
        names = " and ".join(picture_name(placement.pictures[file], placement) for file in odd)
        return (f"{words}; those of {names} {other}", _CORRECT) if other else (words, _MOVED)
    if told and doubtful and (other := better_reading(placement, told, files, limit)):
        return f"they {other}", _CORRECT
    return None


def _contradicting(
    placement: Placement, distances: Mapping[tuple[str, str], PairDistance], limit: float
) -> tuple[list[str], str]:
    """Pictures whose matches are far off while those of all other pairs fit, and the distances."""
    fitting = [pair.median for pair in distances.values() if pair.median <= limit]
    limit = max(limit, _FARTHER * float(np.median(fitting or [0.0])))
    judged = {
        files: JudgedPair(pair.matches, pair.median <= limit) for files, pair in distances.items()
    }
    odd = sorted(odd_cameras(judged), key=placement.model.pictures.index)
    texts = []
    for file in odd:
        off = {b if a == file else a: distances[a, b].median
               for (a, b), pair in judged.items() if file in (a, b) and not pair.fits}  # fmt: skip
        farthest = sorted(off, key=lambda other: -off[other])[:_LISTED]
        name, *names = (picture_name(placement.pictures[x], placement) for x in (file, *farthest))
        listed = [f"{off[x]:.1f} with {other}" for x, other in zip(farthest, names, strict=True)]
        texts.append(f"{name}: {', '.join(listed).replace(' with', ' pixels with', 1)}")
    if not odd:
        return [], ""
    others = [files for files in judged if not set(odd) & set(files)]
    rest = max(distances[files].median for files in others if judged[files].fits)
    which = "all" if all(judged[files].fits for files in others) else "most"
    text = f"those of {which} other pairs are at most {rest:.2g} pixels off"
    return odd, f"{'; '.join(texts)}; {text}"
