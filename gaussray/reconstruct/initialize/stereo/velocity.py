"""Displacements of moving points: one timestamp's points registered non-rigidly with another's."""

from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from gaussray.reconstruct.initialize.embedded_deformation import (
    carried,
    registrable,
    resting_surface,
)
from gaussray.reconstruct.initialize.from_points import typical_gap
from gaussray.reconstruct.initialize.nonrigid_registration import (
    RegistrationOptions,
    registered_surface,
    registration_options,
)
from gaussray.reconstruct.initialize.stereo.points import StereoPoints


# The gaps and the difference of colours that count as 1 in a residual, and where it ends. Of points
# without a match, the velocity of those around them is better than none: few shall count as lost.
_GAPS, _COLOR, _LOST = 3.0, 0.3, 3.0
# Points around one whose mean its residual is.
_AROUND = 12


def velocity_options(platform: str) -> RegistrationOptions:
    """Settings for neighbouring times with which a device (cpu, gpu) needs about a second for each,
    chosen on one synthetic capture with known motion: fast things are found by wide matches.

    Args:
        platform: kind of the device, as JAX names it; all but cpu are GPUs.
    """
    options = replace(registration_options(platform), stiff=(30.0, 0.3), width=(24.0, 3.0))
    return replace(options, source=2000, target=4000) if platform == "cpu" else options


class PointMotion(NamedTuple):
    """How each point moves until another timestamp.

    Args:
        displacement: in scene units.
        residual: mean distance of its moved surroundings from the points there by place and colour,
            in three gaps between points (3: lost).
    """

    displacement: Float[np.ndarray, "points 3"]
    residual: Float[np.ndarray, " points"]


def point_motion(
    here: StereoPoints,
    there: StereoPoints,
    *,
    options: RegistrationOptions | None = None,
    seed: int = 0,
) -> PointMotion:
    """Where the points of one timestamp are at another; lost where either has too few.

    Args:
        here: the points of the timestamp.
        there: the points of the other timestamp.
        options: how carefully to register; None chooses by device.
        seed: of the choice of points.
    """
    options = options or velocity_options(jax.default_backend())
    dice = np.random.default_rng([seed, 3])
    lost = PointMotion(
        np.zeros_like(here.position), np.full(len(here.scale), _LOST, here.position.dtype)
    )
    own, other = (registrable(x.position, dice) for x in (here, there))
    surface = resting_surface(
        here.position[own], here.color[own], control=options.control, source=options.source
    )
    if surface is None:
        return lost
    start = surface.graph.pivot, np.tile([1.0, 0, 0, 0], (options.control, 1))
    motion = registered_surface(
        surface, there.position[other], there.color[other], start, options=options
    )
    if motion is None:
        return lost
    place = carried(surface.in_gaps(here.position), surface.graph, *motion)
    moved = (surface.gap * place + surface.middle).astype(here.position.dtype)
    residual = _residual(here, moved, StereoPoints(*(x[other] for x in there)))
    return PointMotion(moved - here.position, residual)


def _residual(here: StereoPoints, moved: np.ndarray, there: StereoPoints) -> np.ndarray:
    gap = typical_gap(there.position)
    ours, theirs = (
        np.concatenate([place / (_GAPS * gap), color / _COLOR], axis=1)
        for place, color in ((moved, here.color), (there.position, there.color))
    )
    away, _ = KDTree(theirs).query(ours, distance_upper_bound=_LOST, workers=-1)
    away = np.minimum(away, _LOST)
    near = KDTree(here.position).query(here.position, k=_AROUND, workers=-1)[1]
    return away[near].mean(axis=1).astype(here.position.dtype)
