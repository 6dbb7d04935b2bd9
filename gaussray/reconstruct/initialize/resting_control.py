"""Control points that begin at rest, where nothing tells yet how things move.

The idea of few control points that carry all Gaussians is that of SC-GS (Huang et al. 2024). There
a network gives their poses; here they are learnt directly (`optimize.smooth_motion`).
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from gaussray.scene.control_points import ControlPoints


# Neighbours whose mean distance is the width of a control point's weights.
_NEIGHBOURS = 3


def resting_control_points(
    position: Float[np.ndarray, "points 3"],
    times: Float[np.ndarray, " instants"],
    *,
    count: int,
    seed: int,
) -> ControlPoints:
    """Control points at rest, spread evenly over points: each next one is the point that is
    farthest from those before (farthest-point sampling).

    Args:
        position: places in the world, at least one.
        times: timestamps at which they get poses, increasing.
        count: how many; as many as there are points, if these are fewer.
        seed: chooses the first one.
    """
    first = int(np.random.default_rng([seed, 4]).integers(len(position)))
    chosen, away = [first], np.full(len(position), np.inf)
    while len(chosen) < min(count, len(position)):
        step = position - position[chosen[-1]]
        away = np.minimum(away, np.sum(step * step, axis=1))
        chosen.append(int(np.argmax(away)))
    pivot = position[chosen]
    near, _ = KDTree(pivot).query(pivot, k=min(_NEIGHBOURS + 1, len(pivot)))
    radius = near.reshape(len(pivot), -1)[:, 1:].sum(axis=1) / _NEIGHBOURS
    turn = np.zeros((len(pivot), len(times), 4), np.float32)
    turn[..., 0] = 1
    return ControlPoints(
        pivot=jnp.asarray(pivot, jnp.float32),
        # A lone control point moves all Gaussians alike.
        radius=jnp.asarray(np.where(radius > 0, radius, 1), jnp.float32),
        time=jnp.asarray(times, jnp.float32),
        path=jnp.zeros((len(pivot), len(times), 3), jnp.float32),
        turn=jnp.asarray(turn),
    )
