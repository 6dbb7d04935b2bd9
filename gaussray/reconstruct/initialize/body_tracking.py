"""Where the rigid bodies are at every time, found in the pictures before anything is optimised.

A fit by gradients finds a pose only from nearby: a wedge of a ball must still overlap itself. So
the pose of each body is searched for, time after time (`pose_search`).
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key, PRNGKeyArray
from scipy.spatial import KDTree

from gaussray.camera.camera import Camera, project
from gaussray.geometry import multiply, normalize_quaternion
from gaussray.reconstruct.initialize import appearance
from gaussray.reconstruct.initialize.appearance import CHANGES, Shown
from gaussray.reconstruct.initialize.pose_cost import (
    Known,
    Mismatch,
    Others,
    Pictures,
    Pose,
    mismatch_at,
    none_found,
    rest_pose,
    toward_views,
)
from gaussray.reconstruct.initialize.pose_search import (
    Start,
    TrackOptions as TrackOptions,
    search_poses,
    turn_candidates,
)
from gaussray.reconstruct.initialize.regrouping import MovingGaussians, move, regrouped
from gaussray.reconstruct.initialize.steady_turns import (
    continuous,
    expected_turns,
    steadiest,
    tumbling,
)
from gaussray.scene.bodies import Bodies


# Two bodies are in one place if their middles are closer than this part of their sizes together,
# and of their distance at the first time: parts of one thing may well lie within one another.
CLASH = 0.5
# Of two bodies that fit one place equally well, the one that moved less is there: what a motion by
# the own size adds to the cost, which is a difference of colour and at most 0.3.
MOVED = 0.01
# A body was found for certain where its cost is at most so many times the first quartile of its
# costs so far.
CERTAIN = 1.25
# And no better pose is looked for where it is at most so many times that.
ENOUGH = 1.15
# Searches for bodies that were found in the place of another one.
AGAIN = 2


def track(
    bodies: Bodies,
    gaussians: MovingGaussians,
    shown: Callable[[Int[np.ndarray, " frames"]], Shown],
    camera: Camera,
    *,
    options: TrackOptions,
    seed: int,
    report: Callable[[str], Callable[[int], None]] = lambda work: lambda done: None,
) -> Bodies:
    """The bodies with path and turn set to the poses that explain the pictures best.

    Parts of a body that another body occludes do not count. Poses are approximate (a tenth of a
    radian, a tenth of a body's size): the fit refines them. Once they are found, groups of points
    are cut and joined as the pictures say (`regrouping`), and searched for once more. Bodies whose
    poses explain the pictures hardly better than rest are left out.

    Args:
        bodies: the candidate bodies, at rest.
        gaussians: the moving Gaussians.
        shown: gives the pictures of some training frames.
        camera: the cameras of all training frames, stacked.
        options: how thoroughly to search.
        seed: for the random poses.
        report: called with the name of each search; gives what is called with the number of times
            done.
    """
    instants = np.asarray(bodies.time)
    if not bodies.pivot.shape[0] or len(instants) < 2 or not options.poses:
        return bodies
    time = np.asarray(camera.time)
    shrink = max(1, min(camera.film.width, camera.film.height) // options.side)

    def pictures_at(i: int) -> Pictures:
        frames = np.flatnonzero(time == instants[i].astype(time.dtype))
        views = jax.tree.map(lambda x: x[frames], camera)
        return Pictures(views, appearance.layers(shown(frames), shrink, options.blur), shrink)

    first, key = pictures_at(0), jax.random.key(seed)

    def found_by(
        work: str, bodies: Bodies, gaussians: MovingGaussians
    ) -> tuple[Known, Known, list[Pose], Mismatch]:
        pixel = _pixel_width(first.views, bodies.pivot, shrink)
        known = _known(bodies, gaussians, pixel, options.points, seed)
        judged = toward_views(known, first)
        found = _found(key, known, judged, instants, pictures_at, options, report(work))
        return known, judged, *found

    known, judged, poses, mismatch = found_by("track", bodies, gaussians)
    if (groups := regrouped(bodies, gaussians, known, mismatch)) is not None:
        bodies, gaussians = groups
        known, judged, poses, mismatch = found_by("track again", bodies, gaussians)
    steady = _with_steady_turns(key, known, poses, instants, pictures_at, options)
    if steady is not poses:
        poses = steady
        mismatch = _summed(
            [mismatch_at(pose, judged, pictures_at(i)) for i, pose in enumerate(steady) if i]
        )
    path = jnp.stack([pose.path for pose in poses], axis=1).astype(bodies.path.dtype)
    turn = jnp.stack([pose.turn for pose in poses], axis=1).astype(bodies.turn.dtype)
    found = eqx.tree_at(lambda b: (b.path, b.turn), bodies, (path, turn))
    real = np.flatnonzero(move(mismatch))
    return Bodies(
        found.pivot[real], found.radius[real], found.time, found.path[real], found.turn[real]
    )


def _pixel_width(
    views: Camera, pivot: Float[Array, "bodies 3"], shrink: int
) -> Float[np.ndarray, " bodies"]:
    """Width in scene units of a pixel of the shrunk pictures at every body: the median over the
    views that show it, 0 where none does."""
    slope = jax.vmap(jax.vmap(jax.jacfwd(project, argnums=1), (None, 0)), (0, None))
    pixels = np.linalg.norm(np.asarray(eqx.filter_jit(slope)(views, pivot)), axis=(2, 3))
    # Both rows of the slope are about the focal length over the distance.
    pixels = np.where(np.isfinite(pixels), pixels / np.sqrt(2), 0)
    shown = (column[column > 0] for column in pixels.T)
    return np.array([shrink / np.median(column) if len(column) else 0.0 for column in shown])


def _known(
    bodies: Bodies,
    gaussians: MovingGaussians,
    pixel: Float[np.ndarray, " bodies"],
    points: int,
    seed: int,
) -> Known:
    """Equally many points of every body, stacked. Each has the mean colour of all within the width
    of a pixel, which is what a picture shows of them."""
    dice, parts = np.random.default_rng(seed), []
    for i, pivot in enumerate(np.asarray(bodies.pivot)):
        rows = np.flatnonzero(gaussians.body == i)
        chosen = dice.choice(rows, points, replace=len(rows) < points)
        position, normal = gaussians.position[chosen], gaussians.normal[chosen]
        near = KDTree(gaussians.position[rows]).query_ball_point(position, pixel[i])
        color = np.stack([gaussians.color[rows[x]].mean(axis=0) for x in near])
        arm = position - pivot
        outward = np.where(np.sum(arm * normal, axis=1, keepdims=True) < 0, -1, 1)
        size = np.sqrt(np.mean(np.sum(arm * arm, axis=1)))
        look = appearance.look(color)
        look = np.pad(look, ((0, 0), (0, 1)), constant_values=CHANGES)
        parts.append((position, normal * outward, look, pivot, size))
    return Known(*(jnp.asarray(np.stack(x), jnp.float32) for x in zip(*parts, strict=True)))


def _last_certain(
    costs: list[Float[np.ndarray, " bodies"]],
) -> tuple[Int[np.ndarray, " bodies"], Float[Array, " bodies"]]:
    """The last time at which each body was found about as well as usual, and the cost at which no
    better pose is looked for."""
    cost = np.stack(costs)
    usual = np.quantile(cost[1:], 0.25, axis=0) if len(cost) > 1 else cost[0]
    certain = cost <= CERTAIN * usual
    last = len(cost) - 1 - np.argmax(certain[::-1], axis=0)
    return last, jnp.asarray(ENOUGH * usual, jnp.float32)


def _found(
    key: PRNGKeyArray,
    known: Known,
    judged: Known,
    instants: Float[np.ndarray, " times"],
    pictures_at: Callable[[int], Pictures],
    options: TrackOptions,
    report: Callable[[int], None],
) -> tuple[list[Pose], Mismatch]:
    """The poses of known bodies at all times, one time after the other; and how much these bodies,
    as they are judged (`toward_views`), differ from the pictures, summed over the times."""
    count = len(known.size)
    poses = [jax.tree.map(np.asarray, rest_pose(known))]
    costs, mismatches = [np.zeros(count)], []
    for i in range(1, len(instants)):
        pictures = pictures_at(i)
        certain, enough = _last_certain(costs)
        path, turn = (np.stack(x)[certain, np.arange(count)] for x in zip(*poses, strict=True))
        expected = _ahead(poses, instants[: i + 1])
        since = jnp.asarray(i - certain, jnp.float32)
        last = Pose(jnp.asarray(path), jnp.asarray(turn))
        start = Start(expected, last, since, none_found(expected, known))
        keys = jax.random.split(jax.random.fold_in(key, i), count)
        pose, cost = _search_apart(keys, known, start, enough, pictures, options)
        poses.append(jax.tree.map(np.asarray, pose))
        costs.append(np.asarray(cost))
        mismatches.append(mismatch_at(pose, judged, pictures))
        report(i)
    return poses, _summed(mismatches)


def _summed(mismatches: list[Mismatch]) -> Mismatch:
    """How much bodies differ from the pictures, over all times."""
    return jax.tree.map(lambda *x: np.sum(np.stack(x), axis=0), *mismatches)


def _search_apart(
    keys: Key[Array, " bodies"],
    known: Known,
    start: Start,
    enough: Float[Array, " bodies"],
    pictures: Pictures,
    options: TrackOptions,
) -> tuple[Pose, Float[Array, " bodies"]]:
    """The best pose of every body, and its cost. Bodies that were found in one place are told
    apart: the one that fits best, or of equals the one that moved least, stays, and the others are
    searched for again, as something that the first may occlude, but that does not cover it."""
    pose, cost = search_poses(keys, known, start, enough, pictures, options)
    for _ in range(AGAIN):
        moved = jnp.linalg.norm(pose.path - start.expected.path, axis=1) / known.size
        again = _in_the_place_of_another(pose, np.asarray(cost + MOVED * moved), known)
        if not again.any():
            break
        pick = jnp.asarray(again)
        apart = start._replace(others=Others(pose, ~pick))
        found, found_cost = search_poses(keys, known, apart, enough, pictures, options)
        pose = Pose(*(jnp.where(pick[:, None], *x) for x in zip(found, pose, strict=True)))
        cost = jnp.where(pick, found_cost, cost)
    return pose, cost


def _with_steady_turns(
    key: PRNGKeyArray,
    known: Known,
    poses: list[Pose],
    instants: Float[np.ndarray, " times"],
    pictures_at: Callable[[int], Pictures],
    options: TrackOptions,
) -> list[Pose]:
    """The poses, with other turns of bodies that tumble where a steadier spin explains the pictures
    as well."""
    turn = np.stack([np.asarray(pose.turn) for pose in poses], axis=1)
    chosen = np.flatnonzero(tumbling(turn, instants))
    if not len(chosen):
        return poses
    found, costs = [], []
    for i in range(1, len(instants)):
        keys = jax.random.split(jax.random.fold_in(key, len(instants) + i), len(chosen))
        likely = np.stack([expected_turns(turn[body], instants, i) for body in chosen])
        which = jnp.asarray(chosen), jnp.asarray(likely, turn.dtype)
        some, cost = turn_candidates(keys, *which, known, poses[i], pictures_at(i), options)
        found.append(jax.tree.map(np.asarray, some))
        costs.append(np.asarray(cost))
    path = np.stack([np.asarray(pose.path) for pose in poses], axis=1)
    for k, body in enumerate(chosen):
        candidates = [turn[body, :1], *(some.turn[k] for some in found)]
        own = [np.zeros(1), *(cost[k] for cost in costs)]
        best = steadiest(candidates, own, instants)[1:]
        for i, pick in enumerate(best, 1):
            turn[body, i] = found[i - 1].turn[k][pick]
            path[body, i] = found[i - 1].path[k][pick]
        turn[body] = continuous(turn[body])
    times = range(len(instants))
    return [Pose(jnp.asarray(path[:, i]), jnp.asarray(turn[:, i])) for i in times]


def _in_the_place_of_another(
    pose: Pose, cost: Float[np.ndarray, " bodies"], known: Known
) -> Bool[np.ndarray, " bodies"]:
    """Which bodies are where another one of less cost is."""

    def apart(place: np.ndarray) -> np.ndarray:
        return np.linalg.norm(place[:, None] - place[None], axis=-1)

    pivot, size = np.asarray(known.pivot), np.asarray(known.size)
    limit = CLASH * np.minimum(size[:, None] + size[None], apart(pivot))
    clash = apart(pivot + np.asarray(pose.path)) < limit
    return np.any(clash & (cost[:, None] > cost[None]), axis=1)


def _ahead(poses: list[Pose], instants: np.ndarray) -> Pose:
    """Where the last two poses lead at steady speed."""
    last = poses[-1]
    if len(poses) == 1:
        return last
    ahead = (instants[-1] - instants[-2]) / (instants[-2] - instants[-3])
    return _onward(poses[-2], last, jnp.asarray(ahead, last.path.dtype))


@jax.jit
def _onward(before: Pose, last: Pose, ahead: Float[Array, ""]) -> Pose:
    """The same step from the last pose, for a time that is `ahead` times as long."""
    back = before.turn * jnp.asarray([[1, -1, -1, -1]], before.turn.dtype)
    step = multiply(last.turn, back)
    step = jnp.where(step[:, :1] < 0, -step, step)
    onward = (ahead * step).at[:, 0].add(1 - ahead)
    turn = normalize_quaternion(multiply(normalize_quaternion(onward), last.turn))
    return Pose(last.path + ahead * (last.path - before.path), turn)
