"""Displacements of moving points: one timestamp's points registered non-rigidly with another's."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from gaussray.reconstruct.initialize.from_points import typical_gap
from gaussray.reconstruct.initialize.nonrigid_registration import (
    FEWEST,
    RegistrationOptions,
    carried,
    control_graph,
    dense,
    embedded_points,
    padded_points,
    registered,
    registrable,
    registration_options,
)
from gaussray.reconstruct.initialize.stereo.points import StereoPoints


# Distances between features beyond which a point counts as lost, not as so much worse; the
# difference of colours that counts as far as a gap; and the points around one that speak for it.
_LOST, _COLOR, _AROUND = 3.0, 0.1, 12


class PointMotion(NamedTuple):
    """How each point moves until another timestamp.

    Args:
        displacement: in scene units.
        residual: mean distance of its moved surroundings from the points there by place and colour,
            in gaps between points (3: lost).
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
    options = options or registration_options(jax.default_backend())
    dice = np.random.default_rng([seed, 3])
    lost = PointMotion(
        np.zeros_like(here.position), np.full(len(here.scale), _LOST, here.position.dtype)
    )
    own, other = registrable(here.position), registrable(there.position)
    if min(len(own), len(other)) < FEWEST:
        return lost
    gap = typical_gap(here.position[own])
    own = own[dense(here.position[own], gap)]
    if len(own) < FEWEST:
        return lost
    middle = here.position[own].mean(axis=0)
    position = (here.position - middle) / gap
    own, other = dice.permutation(own), dice.permutation(other)[: options.target]
    graph = control_graph(position[own], options.control)
    own = own[: options.source]
    surface = embedded_points(position[own], here.color[own], graph, options.source)
    target = (there.position[other] - middle) / gap
    goal = padded_points(target, there.color[other], options.target)
    still = np.zeros((options.control, 4), np.float32)
    still[:, 0] = 1
    motion = registered(surface, graph, goal, (graph.pivot, still), options=options)
    if motion is None:
        return lost
    moved = gap * carried(position, graph, *motion) + middle
    residual = _residual(here, moved, there)
    return PointMotion((moved - here.position).astype(here.position.dtype), residual)


def _residual(here: StereoPoints, moved: np.ndarray, there: StereoPoints) -> np.ndarray:
    gap = typical_gap(there.position)
    ours, theirs = (
        np.concatenate([place / gap, color / _COLOR], axis=1)
        for place, color in ((moved, here.color), (there.position, there.color))
    )
    away, _ = KDTree(theirs).query(ours, distance_upper_bound=_LOST)
    away = np.minimum(away, _LOST)
    near = KDTree(here.position).query(here.position, k=_AROUND)[1]
    return away[near].mean(axis=1).astype(here.position.dtype)
