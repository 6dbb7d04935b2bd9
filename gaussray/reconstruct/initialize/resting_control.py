"""Control points that begin at rest, where nothing tells yet how things move.

The idea of few control points that carry all Gaussians is that of SC-GS (Huang et al. 2024). There
a network gives their poses; here they are learnt directly (`optimize.smooth_motion`).
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from gaussray.reconstruct.initialize.embedded_deformation import spread_out
from gaussray.scene.bodies import bodies_at_rest
from gaussray.scene.control_points import ControlPoints


# Neighbours whose mean distance is the width of a control point's weights.
_NEIGHBOURS = 3


def resting_control_points(
    position: Float[np.ndarray, "points 3"], times: Float[np.ndarray, " instants"], *, count: int
) -> ControlPoints:
    """Control points at rest, spread evenly over points.

    Args:
        position: places in the world, at least one.
        times: timestamps at which they get poses, increasing.
        count: how many; as many as there are points, if these are fewer.
    """
    pivot = position[spread_out(position, min(count, len(position)))]
    radius = np.zeros(len(pivot))
    if len(pivot) > 1:
        near, _ = KDTree(pivot).query(pivot, k=min(_NEIGHBOURS + 1, len(pivot)))
        radius = np.asarray(near)[:, 1:].mean(axis=1)
    # A lone control point moves all Gaussians alike.
    radius = np.where(radius > 0, radius, 1)
    rest = bodies_at_rest(*(jnp.asarray(x, jnp.float32) for x in (pivot, radius, times)))
    return ControlPoints(rest.pivot, rest.radius, rest.time, rest.path, rest.turn)
