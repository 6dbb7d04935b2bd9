"""Non-rigid registration of points with those of another time, by an embedded deformation.

Points that hang on control points are matched with the points of the other time by place and
colour, and the control points move to where the matches want them, as rigidly as possible among
neighbours (Sorkine and Alexa 2007). Matches are wide and the surface is stiff at first.
"""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import cho_factor, cho_solve
from jaxtyping import Array, Float

from gaussray.geometry import best_rotation, product, rotation_matrix
from gaussray.reconstruct.initialize.embedded_deformation import (
    FEWEST_POINTS,
    NOWHERE,
    ControlGraph,
    EmbeddedPoints,
    RestingSurface,
    padded_rows,
)


# Places and rotations of control points.
ControlPose = tuple[Float[np.ndarray, "control 3"], Float[np.ndarray, "control 4"]]


class RegistrationOptions(eqx.Module):
    """Settings of non-rigid registration, chosen for surface tracking on one synthetic capture with
    known motion.

    Args:
        control: number of control points.
        source: number of points that are matched.
        target: number of points of the other time that they are matched with.
        rounds: rounds of matching.
        solves: in each round, how often places and rotations are solved for in turn.
        stiff: weight of rigidity in the first and the last round.
        width: gaps between points that count as far as `color`, in the first and the last round.
        color: difference of colours that counts as far as one width.
    """

    control: int = eqx.field(static=True, default=1200)
    source: int = eqx.field(static=True, default=6000)
    target: int = eqx.field(static=True, default=12000)
    rounds: int = eqx.field(static=True, default=12)
    solves: int = eqx.field(static=True, default=3)
    stiff: tuple[float, float] = eqx.field(static=True, default=(30.0, 1.0))
    width: tuple[float, float] = eqx.field(static=True, default=(16.0, 2.0))
    color: float = eqx.field(static=True, default=0.15)


def registration_options(platform: str) -> RegistrationOptions:
    """Settings with which a device (cpu, gpu) needs a second or two for a time.

    Args:
        platform: kind of the device, as JAX names it; all but cpu are GPUs.
    """
    return (
        RegistrationOptions(control=600, source=3000, target=6000)
        if platform == "cpu"
        else RegistrationOptions()
    )


class PaddedPoints(NamedTuple):
    """Points of another time, in gaps, and rows far away."""

    position: Float[Array, "rows 3"]
    color: Float[Array, "rows 3"]


def padded_points(
    position: Float[np.ndarray, "points 3"], color: Float[np.ndarray, "points 3"], rows: int
) -> PaddedPoints:
    """The points, and rows far away.

    Args:
        position: the points, in gaps.
        color: their colours.
        rows: how many there shall be.
    """
    lack = rows - len(position)
    far, shade = padded_rows(position, lack, NOWHERE), padded_rows(color, lack, 0)
    return PaddedPoints(jnp.asarray(far, jnp.float32), jnp.asarray(shade, jnp.float32))


def registered_surface(
    surface: RestingSurface,
    position: Float[np.ndarray, "points 3"],
    color: Float[np.ndarray, "points 3"],
    start: ControlPose,
    *,
    options: RegistrationOptions,
) -> ControlPose | None:
    """Places (in gaps) and rotations of the control points of a surface at another time; None
    where that has too few points, or there are none.

    Args:
        surface: the points of one time.
        position: points of the other time, in the world; of more than options.target the first.
        color: their colours.
        start: a guess of the places and rotations.
        options: how carefully to register.
    """
    if len(position) < FEWEST_POINTS:
        return None
    there = surface.in_gaps(position[: options.target])
    goal = padded_points(there, color[: options.target], options.target)
    return registered(surface.points, surface.graph, goal, start, options=options)


def registered(
    surface: EmbeddedPoints,
    graph: ControlGraph,
    there: PaddedPoints,
    start: ControlPose,
    *,
    options: RegistrationOptions,
) -> ControlPose | None:
    """Places and rotations of the control points at another time; None where there are none.

    Args:
        surface: points on the control points.
        graph: the control points at rest.
        there: the points of the other time.
        start: a guess of the places and rotations.
        options: how carefully to register.
    """
    pivot, strength, place, turn = (
        jnp.asarray(x, jnp.float32) for x in (graph.pivot, graph.strength, *start)
    )
    sizes = [
        jnp.asarray(np.geomspace(first, last, options.rounds), pivot.dtype)
        for first, last in (options.width, options.stiff)
    ]
    control = pivot, graph.edge, strength
    motion = _registered(
        surface, control, there, (place, turn), sizes, options.color, solves=options.solves
    )
    place, turn = (np.asarray(x) for x in motion)
    return (place, turn) if np.isfinite(place).all() and np.isfinite(turn).all() else None


@partial(jax.jit, static_argnames="solves")
def _registered(surface, control, there, start, sizes, shade, *, solves):
    pivot, (a, b), strength = control
    count, dtype = len(pivot), pivot.dtype
    near, hold = surface.near, surface.weight
    real = jnp.sum(hold, axis=1) > 0
    stiffness = jnp.zeros((count, count), dtype)
    for x, y, sign in ((a, a, 1), (b, b, 1), (a, b, -1), (b, a, -1)):
        stiffness = stiffness.at[x, y].add(sign * strength)
    rest = pivot[b] - pivot[a]
    lever = surface.position[:, None] - pivot[near]

    def arms(turn):
        turned = product("nkij,nkj->nki", rotation_matrix(turn)[near], lever)
        return jnp.sum(hold[..., None] * turned, axis=1)

    def matched(place, turn, width):
        """Weight and goal of each point: the mean of the point it is nearest to and of those that
        are nearest to it, by place and colour."""
        now = jnp.sum(hold[..., None] * place[near], axis=1) + arms(turn)
        now = jnp.where(real[:, None], now, jnp.asarray(-NOWHERE, dtype))
        ours = _features(now, surface.color, width, shade)
        theirs = _features(there.position, there.color, width, shade)
        square = jnp.sum(ours**2, axis=1)[:, None] + jnp.sum(theirs**2, axis=1)[None]
        square = square - 2 * product("nd,md->nm", ours, theirs)
        best, back = jnp.argmin(square, axis=1), jnp.argmin(square, axis=0)
        sure = _likeness(ours, theirs[best]) + 1e-6
        agree = _likeness(ours[back], theirs)
        total = sure.at[back].add(agree)
        goal = sure[:, None] * there.position[best]
        goal = goal.at[back].add(agree[:, None] * there.position)
        return jnp.where(real, total, 0), goal / total[:, None]

    def one_round(motion, sizes):
        width, stiff = sizes
        place, turn = motion
        weight, goal = matched(place, turn, width)
        heavy = hold * weight[:, None]
        both = heavy[:, :, None] * hold[:, None, :]
        # Control points that nothing pulls at stay; single precision needs so much of it.
        stay = 1e-4 * (1 + stiff)
        matrix = stiff * stiffness + stay * jnp.eye(count, dtype=dtype)
        factor = cho_factor(matrix.at[near[:, :, None], near[:, None, :]].add(both))
        for _ in range(solves):
            rotation = rotation_matrix(turn)
            push = product("eij,ej->ei", 0.5 * (rotation[a] + rotation[b]), rest)
            push = stiff * strength[:, None] * push
            pull = jnp.zeros_like(place).at[b].add(push).at[a].add(-push)
            lack = heavy[..., None] * (goal - arms(turn))[:, None]
            place = cho_solve(factor, (pull + stay * place).at[near].add(lack))
            spans = strength[:, None, None] * rest[:, :, None] * (place[b] - place[a])[:, None]
            turn = best_rotation(jnp.zeros((count, 3, 3), dtype).at[a].add(spans))
        return (place, turn), None

    motion, _ = jax.lax.scan(one_round, start, tuple(sizes))
    return motion


def _features(position, color, width, shade):
    return jnp.concatenate([position / width, color / shade], axis=-1)


def _likeness(a, b):
    return jnp.exp(-0.5 * jnp.sum((a - b) ** 2, axis=-1))
