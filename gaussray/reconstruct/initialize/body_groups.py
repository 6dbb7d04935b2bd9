"""Rigid bodies among points at rest: groups of points that belong together, each in its ball."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from gaussray.scene.bodies import Bodies, bodies_at_rest, body_of


# Rounds of the search for the smallest ball around points: its radius is then right to a hundredth.
_ROUNDS = 100
# Typical gaps within which points belong together: leaves on their stems need 5
# (experiments/reconstruction/README.md). What belongs to nothing that moves is told by tracking.
LINK = 5.0
# Largest number of groups that become bodies, the largest first.
_MOST_GROUPS = 64


def body_groups(
    position: Float[np.ndarray, "points 3"],
    times: Float[np.ndarray, " instants"],
    *,
    known: tuple[Float[np.ndarray, "known 3"], Float[np.ndarray, " known"]] | None = None,
) -> Bodies:
    """The rigid bodies among points, at rest: connected groups, as far as points tell.

    Of new groups the largest 64 become bodies.

    Args:
        position: places in the world, at the first of the times. Two belong to one group if a chain
            of points less than LINK typical gaps apart links them. A group of less than a hundredth
            of the points is no body; without points there are no bodies.
        times: timestamps at which the bodies get poses.
        known: pivots and radii of bodies that were found before; None if there are none. Those that
            still hold a hundredth of the points stay as they are, even if they touch now, and only
            the points outside of these are grouped.
    """
    pivot, radius = np.zeros((0, 3), np.float32), np.zeros(0, np.float32)
    least, rest = max(len(position) / 100, 2.0), position
    if known is not None and len(known[1]) and len(position):
        held = np.asarray(body_of(_resting(*known, times), jnp.asarray(position)))
        large = np.bincount(held, minlength=len(known[1]) + 1)[:-1] >= least
        pivot, radius = known[0][large], known[1][large]
        rest = position[~np.isin(held, np.flatnonzero(large))]
    if len(rest) >= least:
        more = _groups(rest, least)
        pivot, radius = (np.concatenate(x) for x in zip((pivot, radius), more, strict=True))
    return _resting(pivot, radius, times)


def _resting(pivot: np.ndarray, radius: np.ndarray, times: np.ndarray) -> Bodies:
    return bodies_at_rest(*(jnp.asarray(x, jnp.float32) for x in (pivot, radius, times)))


def _groups(
    position: Float[np.ndarray, "points 3"], least: float
) -> tuple[Float[np.ndarray, "groups 3"], Float[np.ndarray, " groups"]]:
    """Pivot and radius of the connected groups of so many points."""
    tree = KDTree(position)
    gap = np.median(
        tree.query(position, k=min(2, len(position)))[0].reshape(len(position), -1)[:, -1]
    )
    pairs = tree.query_pairs(LINK * gap, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(position),) * 2)
    _, label = connected_components(graph, directed=False)
    size = np.bincount(label)
    large = np.argsort(-size, kind="stable")[:_MOST_GROUPS]
    groups = [position[label == i] for i in large[size[large] >= least]]
    balls = [ball_around(group, gap) for group in groups]
    pivot = np.array([center for center, _ in balls], np.float32).reshape(-1, 3)
    return pivot, np.array([reach for _, reach in balls], np.float32)


def ball_around(
    position: Float[np.ndarray, "points 3"], gap: float
) -> tuple[Float[np.ndarray, "3"], float]:
    """Centre of the smallest ball that holds points (Badoiu and Clarkson 2003), and its radius with
    a margin. Of a thing that is seen from above alone, their mean would be too high.

    Args:
        position: places in the world, at least one.
        gap: typical distance of neighbouring points, a part of the margin.
    """
    center = position.mean(axis=0, dtype=np.float64)
    for i in range(1, _ROUNDS):
        farthest = np.argmax(np.sum(np.square(position - center), axis=1))
        center += (position[farthest] - center) / (i + 1)
    reach = float(np.linalg.norm(position - center, axis=1).max())
    return center.astype(position.dtype), 1.05 * reach + gap
