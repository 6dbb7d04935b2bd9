"""Poses of single pictures that cannot be believed: they rest on nothing, lie far off, or are
contradicted by the matches."""

import dataclasses

import numpy as np
from jaxtyping import Bool

from gaussray.prepare.contradictions import SURE, contradicted_pictures, strong_pairs
from gaussray.prepare.findings.finding import Finding
from gaussray.prepare.findings.listed_pictures import listed_pictures
from gaussray.prepare.placement import Placement
from gaussray.prepare.sparse_model import camera_centres, kept_pictures, observations_by_picture
from gaussray.runtime.output import counted


# Fewest observations of a picture of a camera that does not stand still: COLMAP gives a pose from
# 30 matches on, of which more than half were wrong then.
_FEWEST = 15
# Largest distance from the middle of the cameras, in median distances of cameras or points.
_FARTHEST = 50.0


def without_strays(placement: Placement) -> tuple[Placement, list[Finding]]:
    """The placement without pictures whose pose cannot be believed, and a warning that names them.

    Of cameras that do not stand still, these are pictures with hardly an observation, and those
    whose matches surely contradict their poses while those of enough others fit; of all, pictures
    far outside the others. Poses of a calibration are all kept.

    Args:
        placement: poses of the registered pictures.
    """
    if placement.known or not placement.model.pictures:
        return placement, []
    files = placement.model.pictures
    pictures = [placement.pictures[file] for file in files]
    moving = np.array([picture.camera not in placement.still for picture in pictures])
    few = moving & (observations_by_picture(placement.model) < _FEWEST)
    far = _far_off(placement)
    believed = _kept(placement, ~(few | far))
    found = contradicted_pictures(believed, strong_pairs(believed), SURE)
    off = {file: found[file] for file, moves in zip(files, moving, strict=True)
           if moves and file in found}  # fmt: skip
    contradicted = np.isin(files, list(off))
    left = few | far | contradicted
    if not left.any():
        return placement, []
    reasons = []
    for wrong, reason in (
        (far, f"more than {_FARTHEST:.0f} times as far from the middle as most are"),
        (few & ~far, f"fewer than {_FEWEST} observations"),
        (contradicted, _distances_text(off)),
    ):
        strays = [picture for picture, stray in zip(pictures, wrong, strict=True) if stray]
        if strays:
            reasons.append(f"{listed_pictures(strays, placement)} ({reason})")
    count, total = int(left.sum()), len(files)
    finding = Finding(
        "warn",
        "cameras",
        f"{count} of {counted(total, 'pose')} cannot be right, and the picture"
        f"{'s are' if count > 1 else ' is'} left out: {'; '.join(reasons)}",
        "Take the pictures away, or add others between them and their neighbours. Pictures of "
        "cameras that stand still belong into a folder of each camera.",
    )
    strays = frozenset(file for file, wrong in zip(files, left, strict=True) if wrong)
    return dataclasses.replace(_kept(placement, ~left), strays=strays), [finding]


def _kept(placement: Placement, keep: Bool[np.ndarray, " pictures"]) -> Placement:
    return dataclasses.replace(placement, model=kept_pictures(placement.model, keep))


def _distances_text(off: dict[str, tuple[float, float]]) -> str:
    """How far off the matches of some pictures are, and those of the others, in pixels."""
    if not off:
        return ""
    least, most = min(own for own, _ in off.values()), max(own for own, _ in off.values())
    listed = f"{least:.2g}" if len(off) == 1 else f"{least:.2g} to {most:.2g}"
    return (
        f"matches are {listed} pixels from their epipolar lines, those of the others "
        f"{max(rest for _, rest in off.values()):.2g}"
    )


def _far_off(placement: Placement) -> Bool[np.ndarray, " pictures"]:
    """Which pictures were taken far outside the other cameras and the points."""
    centres, points = camera_centres(placement.model), placement.model.points
    middle = np.median(centres, axis=0)
    distance = np.linalg.norm(centres - middle, axis=1)
    # Most cameras may be in one place; what they see is then the measure.
    scale = np.median(distance)
    if len(points):
        scale = max(scale, np.median(np.linalg.norm(points - middle, axis=1)))
    return (scale > 0) & ~(distance <= _FARTHEST * scale)
