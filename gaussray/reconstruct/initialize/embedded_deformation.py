"""An embedded deformation: points that move with the control points near them (Sumner et al. 2007).

Arrays are padded, so that clouds of any size share one program.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.spatial import KDTree

from gaussray.geometry import rotation_matrix
from gaussray.reconstruct.initialize.from_points import inliers, typical_gap


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
NOWHERE = 1e4


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


class RestingSurface(NamedTuple):
    """Points of one time on their control points, in gaps from the middle.

    Args:
        graph: the control points.
        points: points that are matched.
        middle: the middle of all points, in the world.
        gap: the typical one between points, in scene units.
    """

    graph: ControlGraph
    points: EmbeddedPoints
    middle: Float[np.ndarray, "3"]
    gap: float

    def in_gaps(self, position: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, "points 3"]:
        """Places of the world in gaps from the middle."""
        return (position - self.middle) / self.gap


def resting_surface(
    position: Float[np.ndarray, "points 3"],
    color: Float[np.ndarray, "points 3"],
    *,
    control: int,
    source: int,
) -> RestingSurface | None:
    """Points on control points that are spread over them; None where they are too few.

    Args:
        position: the points, without strays and in random order (`registrable`).
        color: their colours.
        control: the number of control points with the missing rows.
        source: the number of points that are matched, with the missing rows.
    """
    if len(position) < FEWEST_POINTS:
        return None
    gap = typical_gap(position)
    kept = _dense(position, gap)
    if kept.sum() < FEWEST_POINTS:
        return None
    position, color = position[kept], color[kept]
    middle = position.mean(axis=0)
    rest = (position - middle) / gap
    graph = control_graph(rest, control)
    points = embedded_points(rest[:source], color[:source], graph, source)
    return RestingSurface(graph, points, middle, gap)


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


def _dense(position: Float[np.ndarray, "points 3"], gap: float) -> Bool[np.ndarray, " points"]:
    """Which points have others around them; `gap` is the typical one."""
    return (
        KDTree(position).query_ball_point(position, 4 * gap, return_length=True, workers=-1)
        >= _AROUND
    )


def control_graph(position: Float[np.ndarray, "points 3"], count: int) -> ControlGraph:
    """Control points on some of the points, each as far as possible from those before it.

    Args:
        position: the points, in gaps; at least `FEWEST_POINTS`.
        count: the number of control points with the missing rows; at most every second point
            becomes one.
    """
    pivot = position[spread_out(position, min(count, len(position) // 2))]
    away, beside = (np.asarray(x) for x in KDTree(pivot).query(pivot, k=_NEIGHBOURS + 1))
    # In gaps: points at one place must not make it 0.
    radius = np.maximum(_WIDTH * away[:, 3], 0.1)
    strength = np.exp(-0.5 * (away[:, 1:] / (2 * radius[:, None])) ** 2)
    lack = count - len(pivot)
    itself = np.arange(len(pivot), count)[:, None]
    beside = np.concatenate([beside[:, 1:], np.repeat(itself, _NEIGHBOURS, axis=1)])
    return ControlGraph(
        len(pivot),
        padded_rows(pivot, lack, -NOWHERE),
        np.pad(radius, (0, lack), constant_values=1),
        (np.repeat(np.arange(count), _NEIGHBOURS), beside.ravel()),
        padded_rows(strength, lack, 0).ravel(),
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
        jnp.asarray(padded_rows(position, lack, 0), jnp.float32),
        jnp.asarray(padded_rows(color, lack, 0), jnp.float32),
        jnp.asarray(padded_rows(near, lack, 0)),
        jnp.asarray(padded_rows(weight, lack, 0), jnp.float32),
    )


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
    found = KDTree(graph.pivot[: graph.count]).query(position, k=_HELD_BY, workers=-1)
    away, near = (np.asarray(x) for x in found)
    weight = np.exp(-0.5 * (away / graph.radius[near]) ** 2) + 1e-9
    return near, weight / weight.sum(axis=1, keepdims=True)


def spread_out(position: Float[np.ndarray, "n 3"], count: int) -> Int[np.ndarray, " count"]:
    """Some of the points, each as far as possible from those before it.

    Args:
        position: the points, at least as many as are wanted.
        count: how many are wanted.
    """
    chosen, away = [len(position) // 2], np.full(len(position), np.inf)
    for _ in range(count - 1):
        step = position - position[chosen[-1]]
        away = np.minimum(away, np.einsum("ni,ni->n", step, step))
        chosen.append(int(away.argmax()))
    return np.array(chosen)


def padded_rows(array: np.ndarray, lack: int, value: float) -> np.ndarray:
    """An array with more rows after its own.

    Args:
        array: the array, of two axes.
        lack: how many rows are missing.
        value: what they hold.
    """
    return np.pad(array, ((0, lack), (0, 0)), constant_values=value)
