"""The free space around the training cameras, in which no static Gaussian stays.

What few cameras see, and nothing else tells, is explained by haze: large faint Gaussians close to a
camera, which give its pictures a tint. Other cameras look through them from elsewhere. But between
a camera and what it films there is nothing, or the camera would show it.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.spatial import KDTree

from gaussray.capture.spread import spread_indices
from gaussray.reconstruct.optimize.rows import EMPTY
from gaussray.reconstruct.optimize.state import State


# Cameras around which space is free, at most, and how many others count as the neighbours of one.
_CAMERAS, _NEIGHBOURS = 256, 4
# How many of the nearest points may be wrong: so many, or a share of all if that is fewer.
_WRONG, _WRONG_SHARE = 20, 0.02


class FreeBalls(eqx.Module):
    """Balls in which nothing is.

    Args:
        center: their centres in the world.
        radius: their radii in scene units.
    """

    center: Float[np.ndarray, "balls 3"]
    radius: Float[np.ndarray, " balls"]


def free_balls(
    eye: Float[np.ndarray, "cameras 3"], position: Float[np.ndarray, "points 3"], share: float
) -> FreeBalls | None:
    """Balls around cameras, and around the places midway between neighbouring ones, that reach a
    share of the way to the nearest points.

    Midway, because that is where pictures will be taken from, too. Of the nearest points a few may
    be wrong.

    Args:
        eye: places of the training cameras in the world; equal ones count once.
        position: points on what the cameras show, in the world.
        share: radius of a ball over the distance from its centre to the points.

    Returns:
        The balls; None without points or with a share of 0.
    """
    if not share or not len(position):
        return None
    eye = np.unique(np.asarray(eye, np.float64), axis=0)
    eye = eye[spread_indices(len(eye), _CAMERAS)]
    neighbours = min(_NEIGHBOURS, len(eye) - 1)
    _, near = KDTree(eye).query(eye, k=neighbours + 1)
    midway = (eye[:, None] + eye[np.reshape(near, (len(eye), -1))[:, 1:]]) / 2
    center = np.concatenate([eye, midway.reshape(-1, 3)])
    rank = max(1, min(_WRONG, int(_WRONG_SHARE * len(position))))
    distance, _ = KDTree(position).query(center, k=rank)
    away = np.reshape(distance, (len(center), rank))[:, -1]
    return FreeBalls(center.astype(np.float32), (share * away).astype(np.float32))


@jax.jit
def in_free_space(space: FreeBalls, mean: Float[Array, "gaussians 3"]) -> Bool[Array, " gaussians"]:
    """Which Gaussians have their centre in a free space.

    Args:
        space: the free space.
        mean: centres of the Gaussians in the world.
    """

    def add(inside: Array, ball: FreeBalls) -> tuple[Array, None]:
        difference = mean - ball.center[None]
        return inside | (jnp.sum(difference * difference, axis=1) < ball.radius**2), None

    none = jnp.zeros(mean.shape[0], bool)
    return jax.lax.scan(add, none, space, unroll=8)[0]


def without_near_gaussians(state: State, space: FreeBalls) -> State:
    """The state without the static Gaussians in a free space: their rows are empty.

    Args:
        state: the state between two blocks of steps.
        space: the free space.
    """
    static = state.parameters.static
    if not len(static.mean):
        return state
    opacity = jnp.where(in_free_space(space, static.mean), EMPTY, static.logit_opacity)
    return eqx.tree_at(lambda s: s.parameters.static.logit_opacity, state, opacity)
