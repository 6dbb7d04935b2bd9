"""How else a calibration may have to be read, where matches contradict it as it is."""

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from itertools import combinations

import numpy as np
from jaxtyping import Float

from gaussray.geometry import BLENDER_AXES
from gaussray.prepare.findings.pair_distances import (
    PairDistance,
    pair_distances,
    typical_distance,
)
from gaussray.prepare.lens_models import LensKeyValues
from gaussray.prepare.placed_cameras import picture_name
from gaussray.prepare.placement import Placement
from gaussray.prepare.pose_math import inverse_pose
from gaussray.prepare.sparse_model import SparseModel


# A reading explains the matches if it leaves at most so large a part of their distances.
_FAR_BETTER = 1 / 3
# It must leave so large a share of their matches: with a wrong lens or pose many have no ray.
_KEPT = 0.8
# Readings are named, at most so many, if they leave at most so many times the least distance.
_AS_GOOD, _NAMED = 1.5, 3
# Exchanges are tried among at most so many pictures.
_EXCHANGED = 16
# Principal points lie in the middle but for this share of half the width.
_CENTERED = 0.1
_FLIP = np.diag(BLENDER_AXES)


def better_reading(
    placement: Placement, pairs: Sequence[tuple[str, str]], files: Sequence[str], limit: float
) -> str:
    """How the calibration must be read so that the matches fit, and far better than as it is:
    other axes, another unit, pictures of another size, two cameras exchanged. Empty if nothing
    that is tried helps.

    Args:
        placement: poses, lenses, keypoints and matches.
        pairs: pairs of files that count.
        files: those whose poses and lenses are read otherwise.
        limit: largest distance in pixels that fits.
    """
    known = pair_distances(placement, pairs)
    most, fitting = min(limit, _FAR_BETTER * typical_distance(known.values())), []
    for model, text, changed in _readings(placement, files):
        again = [pair for pair in pairs if changed.intersection(pair)]
        rest = {pair: known[pair] for pair in known.keys() - set(again)}
        found = pair_distances(dataclasses.replace(placement, model=model), again)
        if _matches(found.values()) < _KEPT * _matches(
            known[pair] for pair in known.keys() & again
        ):
            continue
        distance = typical_distance((rest | found).values())
        if distance < most:
            fitting.append((distance, text))
    if not fitting:
        return ""
    best = min(fitting)[0]
    # Cameras that stand symmetrically fit in several ways.
    texts = [text for distance, text in sorted(fitting) if distance <= _AS_GOOD * best]
    return f"fit ({best:.1f} pixels) if {', or if '.join(texts[:_NAMED])}"


def _matches(distances: Iterable[PairDistance]) -> int:
    """Number of matches of all pairs."""
    return sum(pair.matches for pair in distances)


def _readings(
    placement: Placement, files: Sequence[str]
) -> Iterator[tuple[SparseModel, str, set[str]]]:
    """Models of other readings, what each says, and the pictures that differ."""
    model, rows = placement.model, [placement.model.pictures.index(file) for file in files]
    for poses, text in _other_poses(model.poses[rows], rows == list(range(len(model.poses)))):
        changed = model.poses.copy()
        changed[rows] = poses
        yield dataclasses.replace(model, poses=changed), text, set(files)
    middle = float(np.median([2 * model.lenses[k]["cx"] / model.lenses[k]["w"] for k in rows]))
    factors = [0.5, 2.0]
    if all(abs(middle * factor - 1) > _CENTERED for factor in (1, *factors)):
        factors.append(1 / middle)
    for factor in factors:
        lenses = [_scaled(lens, factor if k in rows else 1) for k, lens in enumerate(model.lenses)]
        width, height = (round(model.lenses[rows[0]][side] / factor) for side in "wh")
        text = (
            f"the calibration is of pictures of about {width} x {height}: give it their size, or "
            f"multiply focal lengths and principal points by {factor:.3g}"
        )
        yield dataclasses.replace(model, lenses=lenses), text, set(files)
    for i, k in combinations(rows if len(rows) <= _EXCHANGED else [], 2):
        order = np.arange(len(model.pictures))
        order[[i, k]] = k, i
        sizes = [{side: lens[side] for side in "wh"} for lens in model.lenses]
        lenses = [model.lenses[n] | size for n, size in zip(order, sizes, strict=True)]
        pair = model.pictures[i], model.pictures[k]
        names = [picture_name(placement.pictures[file], placement) for file in pair]
        exchanged = dataclasses.replace(model, poses=model.poses[order], lenses=lenses)
        yield exchanged, f"{names[0]} and {names[1]} are exchanged", set(pair)


def _other_poses(
    poses: Float[np.ndarray, "pictures 3 4"], everyone: bool
) -> Iterator[tuple[Float[np.ndarray, "pictures 3 4"], str]]:
    """Poses read otherwise, and what that says of them; units tell nothing if all have one."""
    inverse = inverse_pose(poses)
    yield inverse, "R and t are camera-to-world: invert them"
    yield _FLIP @ poses, "the cameras' axes are OpenGL's: negate the rows of y and z"
    yield (
        _FLIP @ inverse,
        "R and t are camera-to-world in OpenGL's axes: negate the columns of y and z, then invert "
        "them",
    )
    for factor in () if everyone else (1000.0, 0.001):
        scaled = np.concatenate([poses[:, :, :3], factor * poses[:, :, 3:]], axis=2)
        yield scaled, f"t has another unit: multiply it by {factor:g}"


def _scaled(lens: LensKeyValues, factor: float) -> LensKeyValues:
    """The lens of pictures that are so many times as large, with the size that it has."""
    return lens | {key: factor * lens[key] for key in ("fl_x", "fl_y", "cx", "cy")}
