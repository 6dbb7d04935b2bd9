"""Poses to try far from where a body is expected, and the choice among those that were tried."""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from gaussray.reconstruct.initialize.pose_cost import Pose


# Standard deviation of the turns at places far away, and half width of turns by any angle, in
# radians.
LOST, SPUN = 0.8, 0.5
# Spots differ by at least so many body sizes, turns at them by so many radians.
DIFFERENT = 0.6


def far_places(key: PRNGKeyArray, count: int, reach: Array, dtype) -> Float[Array, "places 6"]:
    """Changes of a pose: steps of any length, with turns; the first changes nothing.

    Args:
        key: a random key.
        count: how many.
        reach: half width of the steps, which are Cauchy distributed.
        dtype: type of the changes.
    """
    draw = jax.random.normal(key, (count, 7), dtype).at[0, :6].set(0)
    step = reach * draw[:, 3:6] / jnp.maximum(jnp.abs(draw[:, 6:]), 1e-6)
    return jnp.concatenate([LOST * draw[:, :3], step], axis=1)


def far_turns(key: PRNGKeyArray, count: int, nudge: Array, dtype) -> Float[Array, "turns 6"]:
    """Changes of a pose: turns of any angle, with small steps; the first changes nothing.

    Args:
        key: a random key.
        count: how many.
        nudge: standard deviation of the steps.
        dtype: type of the changes.
    """
    draw = jax.random.normal(key, (count, 7), dtype).at[0, :6].set(0)
    turn = SPUN * draw[:, :3] / jnp.maximum(jnp.abs(draw[:, 6:]), 1e-6)
    return jnp.concatenate([turn, nudge * draw[:, 3:6]], axis=1)


def least_costly(pose: Pose, cost: Float[Array, " poses"], count: int) -> Pose:
    """The poses that cost least, in the order of their costs.

    Args:
        pose: the poses.
        cost: what each costs.
        count: how many are kept.
    """
    return jax.tree.map(lambda x: x[jnp.argsort(cost)[:count]], pose)


def distinct_poses(
    pose: Pose, cost: Float[Array, " poses"], count: int, change: Callable[[Pose, Pose], Array]
) -> Pose:
    """The best pose, the best of those that differ from it, the best of those that differ from
    both, and so on.

    Args:
        pose: the poses.
        cost: what each costs.
        count: how many are kept.
        change: gives the difference of two poses.
    """

    def one(cost: Array, _: None) -> tuple[Array, Pose]:
        at = jnp.argmin(cost)
        best = jax.tree.map(lambda x: x[at], pose)
        near = jax.vmap(partial(change, best))(pose) < DIFFERENT
        return jnp.where(near, jnp.inf, cost), best

    return jax.lax.scan(one, cost, length=count)[1]


def step_from(first: Pose, pose: Pose, size: Array) -> Float[Array, ""]:
    """Body sizes from one pose to another.

    Args:
        first: one pose.
        pose: the other one.
        size: size of the body.
    """
    return jnp.linalg.norm(pose.path - first.path) / size


def change_from(first: Pose, pose: Pose, size: Array) -> Float[Array, ""]:
    """Radians and body sizes from one pose to another.

    Args:
        first: one pose.
        pose: the other one.
        size: size of the body.
    """
    along = jnp.abs(jnp.sum(first.turn * pose.turn))
    across = jnp.linalg.norm(first.turn) * jnp.linalg.norm(pose.turn)
    angle = 2 * jnp.arccos(jnp.clip(along / across, 0, 1))
    return angle + step_from(first, pose, size)
