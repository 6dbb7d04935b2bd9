"""Non-rigid registration of points with those of another time, by an embedded deformation.

Points move with the control points near them (Sumner et al. 2007). They are matched with the points
of the other time by place and colour, and the control points move to where the matches want them,
as rigidly as possible among neighbours (Sorkine and Alexa 2007). Matches are wide and the surface
is stiff at first. Arrays are padded, so that clouds of any size share one program.
"""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import cho_factor, cho_solve
from jaxtyping import Array, Bool, Float, Int
from scipy.spatial import KDTree

from gaussray.geometry import best_rotation, product, rotation_matrix
from gaussray.reconstruct.initialize.from_points import inliers


# Points below which nothing is registered, and of a time with more than _MOST, so many are used:
# widths are in gaps between these.
FEWEST_POINTS, _MOST = 64, 12000
# Control points that a moved point hangs on, and neighbours that a control point holds on to.
_HELD_BY, _NEIGHBOURS = 4, 8
# Width of a control point's weights, in distances to its third neighbour.
_WIDTH = 0.7
# Points further from their neighbours than usual by so many standard deviations are left out, and
# those with fewer points than _AROUND within four gaps are no place for a control point.
_STRAY, _AROUND = 5.0, 8
# Where missing rows are, in gaps: points of the other time here, others on the opposite side.
_NOWHERE = 1e4


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


class ControlGraph(NamedTuple):
    """Control points in gaps, which hold one another; padded.

    Args:
        count: number of control points, without the missing rows after them.
        pivot: their places.
        radius: widths of their weights; those of missing rows are 1.
        edge: pairs of neighbours: each and one of its neighbours.
        strength: weight of each pair; 0 in missing rows.
    """

    count: int
    pivot: Float[np.ndarray, "control 3"]
    radius: Float[np.ndarray, " control"]
    edge: tuple[Int[np.ndarray, " pairs"], Int[np.ndarray, " pairs"]]
    strength: Float[np.ndarray, " pairs"]


class EmbeddedPoints(NamedTuple):
    """Points in gaps, and how they hang on control points.

    Args:
        position: the points.
        color: their colours.
        near: the control points that hold each.
        weight: their weights, of sum 1; 0 in missing rows.
    """

    position: Float[Array, "points 3"]
    color: Float[Array, "points 3"]
    near: Int[Array, "points held"]
    weight: Float[Array, "points held"]


class PaddedPoints(NamedTuple):
    """Points of another time, in gaps, and rows far away."""

    position: Float[Array, "rows 3"]
    color: Float[Array, "rows 3"]


def registrable(
    position: Float[np.ndarray, "points 3"], dice: np.random.Generator
) -> Int[np.ndarray, " rows"]:
    """Rows of the points without strays, or of a share of them, in random order.

    Args:
        position: the points.
        dice: what draws the order.
    """
    rows = dice.permutation(len(position))[:_MOST]
    return rows[inliers(position[rows], _STRAY)]


def dense(position: Float[np.ndarray, "points 3"], gap: float) -> Bool[np.ndarray, " points"]:
    """Which points have others around them.

    Args:
        position: the points.
        gap: the typical one between them.
    """
    return KDTree(position).query_ball_point(position, 4 * gap, return_length=True) >= _AROUND


def control_graph(position: Float[np.ndarray, "points 3"], count: int) -> ControlGraph:
    """Control points on some of the points, each as far as possible from those before it.

    Args:
        position: the points, in gaps; at least `FEWEST_POINTS`.
        count: the number of control points with the missing rows; at most every second point
            becomes one.
    """
    pivot = position[_spread_out(position, min(count, len(position) // 2))]
    away, beside = (np.asarray(x) for x in KDTree(pivot).query(pivot, k=_NEIGHBOURS + 1))
    # In gaps: points at one place must not make it 0.
    radius = np.maximum(_WIDTH * away[:, 3], 0.1)
    strength = np.exp(-0.5 * (away[:, 1:] / (2 * radius[:, None])) ** 2)
    lack = count - len(pivot)
    itself = np.arange(len(pivot), count)[:, None]
    beside = np.concatenate([beside[:, 1:], np.repeat(itself, _NEIGHBOURS, axis=1)])
    return ControlGraph(
        len(pivot),
        _with_rows(pivot, lack, -_NOWHERE),
        np.pad(radius, (0, lack), constant_values=1),
        (np.repeat(np.arange(count), _NEIGHBOURS), beside.ravel()),
        _with_rows(strength, lack, 0).ravel(),
    )


def embedded_points(
    position: Float[np.ndarray, "points 3"],
    color: Float[np.ndarray, "points 3"],
    graph: ControlGraph,
    rows: int,
) -> EmbeddedPoints:
    """Points on the control points near them, padded.

    Args:
        position: the points, in gaps.
        color: their colours.
        graph: the control points.
        rows: how many there shall be.
    """
    near, weight = _held(position, graph)
    lack = rows - len(position)
    return EmbeddedPoints(
        jnp.asarray(_with_rows(position, lack, 0), jnp.float32),
        jnp.asarray(_with_rows(color, lack, 0), jnp.float32),
        jnp.asarray(_with_rows(near, lack, 0)),
        jnp.asarray(_with_rows(weight, lack, 0), jnp.float32),
    )


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
    far, shade = _with_rows(position, lack, _NOWHERE), _with_rows(color, lack, 0)
    return PaddedPoints(jnp.asarray(far, jnp.float32), jnp.asarray(shade, jnp.float32))


def carried(
    position: Float[np.ndarray, "points 3"],
    graph: ControlGraph,
    place: Float[np.ndarray, "control 3"],
    turn: Float[np.ndarray, "control 4"],
) -> Float[np.ndarray, "points 3"]:
    """Where points are once the control points have moved.

    Args:
        position: the points beside the control points at rest, in gaps.
        graph: the control points.
        place: their places.
        turn: their rotations, as quaternions.
    """
    near, weight = _held(position, graph)
    rotation = np.asarray(rotation_matrix(jnp.asarray(turn)))[near]
    lever = position[:, None] - graph.pivot[near]
    each = np.einsum("nkij,nkj->nki", rotation, lever) + np.asarray(place)[near]
    return np.sum(weight[..., None] * each, axis=1)


def _held(
    position: Float[np.ndarray, "points 3"], graph: ControlGraph
) -> tuple[Int[np.ndarray, "points held"], Float[np.ndarray, "points held"]]:
    """The control points that hold each point, and their weights."""
    found = KDTree(graph.pivot[: graph.count]).query(position, k=_HELD_BY)
    away, near = (np.asarray(x) for x in found)
    weight = np.exp(-0.5 * (away / graph.radius[near]) ** 2) + 1e-9
    return near, weight / weight.sum(axis=1, keepdims=True)


def _spread_out(position: Float[np.ndarray, "n 3"], count: int) -> Int[np.ndarray, " count"]:
    """Some of the points, each as far as possible from those before it."""
    chosen, away = [len(position) // 2], np.full(len(position), np.inf)
    for _ in range(count - 1):
        step = position - position[chosen[-1]]
        away = np.minimum(away, np.einsum("ni,ni->n", step, step))
        chosen.append(int(away.argmax()))
    return np.array(chosen)


def _with_rows(array: np.ndarray, lack: int, value: float) -> np.ndarray:
    return np.pad(array, ((0, lack), (0, 0)), constant_values=value)


def registered(
    surface: EmbeddedPoints,
    graph: ControlGraph,
    there: PaddedPoints,
    start: tuple[Float[np.ndarray, "control 3"], Float[np.ndarray, "control 4"]],
    *,
    options: RegistrationOptions,
) -> tuple[Float[np.ndarray, "control 3"], Float[np.ndarray, "control 4"]] | None:
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
        now = jnp.where(real[:, None], now, jnp.asarray(-_NOWHERE, dtype))
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
