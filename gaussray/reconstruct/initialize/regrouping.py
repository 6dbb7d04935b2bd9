"""Which points move as one rigid body, as the poses that tracking found tell.

Candidate bodies are groups of points that touch at the first time. The floor below a ball changes
where its shadow passes, so it is taken to move, and is one group with the ball. A ball that few
cameras see then is several groups. Once poses are found the pictures tell: the floor keeps its
colours where it is, and the pieces of the ball are explained by the motion of one of them.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from gaussray.reconstruct.initialize.body_groups import ball_around
from gaussray.reconstruct.initialize.from_points import inliers, typical_gap
from gaussray.reconstruct.initialize.pose_cost import Known, Mismatch
from gaussray.scene.bodies import Bodies, bodies_at_rest


# A body moves if that leaves less than this of the difference that there is if it rests: 0.55 to
# 0.75 for the bodies of the sample and of two other captures, 0.95 to 1.05 for the floor and walls.
# By the motion of another body, too, its points are explained if it leaves less.
WORTH = 0.85
# What is left of a body that is cut must leave less than this: its points were chosen because they
# seem to move. This and the next two were set on one ball that rolls (experiments/captures/log.md).
SURELY = 0.65
# Points are judged with so many around them: one alone has the colour of its surroundings by
# chance.
AROUND = 8
# Less than this share of a body that seems to rest is none: parts of a body of one colour do.
RESTING_SHARE = 0.1
# Points of a body this many spreads farther from their neighbours than usual are strays.
STRAY_POINTS = 3.0


class MovingGaussians(NamedTuple):
    """What tracking reads of the moving Gaussians at the first time: the index of the rigid body of
    each (the number of bodies for none), position, the axis of its disc (of either sign), and
    colour in linear light."""

    body: Int[np.ndarray, " gaussians"]
    position: Float[np.ndarray, "gaussians 3"]
    normal: Float[np.ndarray, "gaussians 3"]
    color: Float[np.ndarray, "gaussians 3"]


def move(mismatch: Mismatch) -> Bool[np.ndarray, " bodies"]:
    """Which bodies move: a floor over which shadows pass changes too, but its colours stay where
    they are."""
    return np.asarray(mismatch.moved < WORTH * mismatch.rests)


def regrouped(
    bodies: Bodies, gaussians: MovingGaussians, known: Known, mismatch: Mismatch
) -> tuple[Bodies, MovingGaussians] | None:
    """The bodies that move, at their first poses, and their Gaussians: without those that rest, and
    with those of other bodies that move alike. None where none is cut or joined.

    Args:
        bodies: the candidate bodies.
        gaussians: the moving Gaussians.
        known: points of each body, by which it was tracked.
        mismatch: how much they differ from the pictures, summed over the times.
    """
    pivot, radius = np.array(bodies.pivot), np.array(bodies.radius)
    place, count = np.asarray(known.place), len(pivot)
    rests, label = resting_points(place, mismatch), moving_alike(pivot, radius, mismatch)
    if not rests.any() and len(np.unique(label)) == count:
        return None
    own, position = gaussians.body.copy(), gaussians.position
    gap = typical_gap(position)
    for body in np.flatnonzero(rests.any(axis=1)):
        rows = np.flatnonzero(own == body)
        near = KDTree(place[body]).query(position[rows])[1]
        own[rows[rests[body][near]]] = count
    changed = {int(label[i]) for i in range(count) if rests[i].any() or label[i] != i}
    own = np.append(label, count)[own]
    for body in changed:
        group = position[own == body]
        pivot[body], radius[body] = ball_around(group[inliers(group, STRAY_POINTS)], gap)
    left = np.unique(label[move(mismatch) | rests.any(axis=1)])
    index = np.full(count + 1, len(left))
    index[left] = np.arange(len(left))
    at_rest = bodies_at_rest(jnp.asarray(pivot[left]), jnp.asarray(radius[left]), bodies.time)
    return at_rest, gaussians._replace(body=index[own])


def resting_points(
    place: Float[np.ndarray, "bodies points 3"], mismatch: Mismatch
) -> Bool[np.ndarray, "bodies points"]:
    """Which points the pictures show where they were at the first time, rather than where the body
    went. A body is cut only if what is left of it clearly moves: else it rests as a whole, and some
    of its points seem to move by chance.

    Args:
        place: points of each body at the first time.
        mismatch: how much they differ from the pictures, summed over the times.
    """
    found = np.zeros(place.shape[:2], bool)
    point, weight = np.asarray(mismatch.point), np.asarray(mismatch.weight)
    for body, position in enumerate(place):
        total, count = point[:, body], weight[:, body]
        near = KDTree(position).query(position, k=min(AROUND, len(position)))[1]
        near = near.reshape(len(position), -1)
        moved, still = _means(total[:, near].sum(axis=-1), count[:, near].sum(axis=-1))
        own = moved > WORTH * still
        # Points of a body that was lost differ from the pictures wherever they are.
        certain = own & (still < total[0].sum() / max(count[0].sum(), 1e-30))
        if certain.mean() < RESTING_SHARE or own.all():
            continue
        moved, still = _means(total[:, ~own].sum(axis=-1), count[:, ~own].sum(axis=-1))
        if moved < SURELY * still:
            found[body] = own
    return found


def moving_alike(
    pivot: Float[np.ndarray, "bodies 3"],
    radius: Float[np.ndarray, " bodies"],
    mismatch: Mismatch,
) -> Int[np.ndarray, " bodies"]:
    """For each body the first of those with which it moves as one: bodies whose balls meet, and of
    which one moves so that it explains what the pictures show of the other.

    Args:
        pivot: middle of each body at the first time.
        radius: radius of each.
        mismatch: how much they differ from the pictures, summed over the times.
    """
    apart = np.linalg.norm(pivot[:, None] - pivot[None], axis=-1)
    explained = mismatch.others < WORTH * mismatch.rests[None]
    joined = explained & (apart < radius[:, None] + radius[None]) & move(mismatch)[:, None]
    _, label = connected_components(joined, directed=False)
    _, first = np.unique(label, return_index=True)
    return first[label]


def _means(
    total: Float[np.ndarray, "2 *any"], count: Float[np.ndarray, "2 *any"]
) -> Float[np.ndarray, "2 *any"]:
    """Weighted means; 0 where no view sees anything, of which nothing is known."""
    return np.where((count > 0).all(axis=0), total / np.maximum(count, 1e-30), 0)
