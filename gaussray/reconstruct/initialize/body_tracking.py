"""Where the bodies are at every instant, found in the pictures before anything is optimised.

A fit by gradients finds a pose only from nearby: a wedge of a ball must still overlap itself. Here
the pose of each body is searched for instead, instant after instant, by the cross-entropy method:
draw poses, keep those under which the body's points fall on pixels that look like them, draw again
around these, first in blurred pictures, then in sharp ones. Brightness counts little, because what
turns under a lamp changes its brightness more than its colour; that a pixel changes at all counts
much.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key, PRNGKeyArray

from gaussray.camera.camera import Camera, project
from gaussray.camera.trajectory import pose_at
from gaussray.geometry import multiply, normalize_quaternion, product, rotation_matrix, turning
from gaussray.reconstruct.initialize import appearance
from gaussray.reconstruct.initialize.appearance import CHANGES, Shown
from gaussray.scene.bodies import Bodies


class TrackOptions(eqx.Module):
    """How thoroughly poses are searched for.

    `points` of each body are looked up under `poses` poses per round; the best `elite` lead to the
    next. `rounds` are made at each of the blurs `blur` (standard deviations in pixels, of pictures
    shrunk to about `side` pixels). No body is tracked if `poses` is 0.
    """

    poses: int = eqx.field(static=True, default=128)
    points: int = eqx.field(static=True, default=300)
    elite: int = eqx.field(static=True, default=12)
    rounds: int = eqx.field(static=True, default=4)
    blur: tuple[float, ...] = eqx.field(static=True, default=(2.0, 1.0, 0.5))
    side: int = eqx.field(static=True, default=128)

    def __check_init__(self):
        if self.poses < 0:
            raise ValueError(f"track.poses must be at least 0, got {self.poses}.")
        for name in ("points", "rounds", "side"):
            if getattr(self, name) < 1:
                raise ValueError(f"track.{name} must be at least 1, got {getattr(self, name)}.")
        if self.poses and not 1 < self.elite < self.poses:
            raise ValueError(
                f"track.elite must be between 1 and track.poses, got {self.elite} of {self.poses}."
            )
        if not self.blur or min(self.blur) < 0:
            raise ValueError(f"track.blur must hold numbers of at least 0, got {self.blur}.")


# A point counts in pictures that see its side by more than this cosine.
GRAZING = 0.25
# A larger difference says that something else is in front, not how much it differs.
MISMATCH = 0.3
# Radians of turn and body sizes of path with which the search at each blur begins, and ends at
# least; the last pair holds for all further ones.
WIDTHS = ((0.35, 0.05), (0.1, 0.02), (0.05, 0.005))
# A body moves if that leaves less than this of the difference that there is if it rests: 0.54 to
# 0.64 for the sample's balls, 1.06 to 1.17 for the floor under them.
WORTH = 0.95
# How wide, and with how many times as many poses, a body is looked for that may have been hit.
LOST, FAR = 0.8, 4


class Pose(NamedTuple):
    """Displacement of a body's pivot and turn about it, since the first instant."""

    path: Float[Array, "*bodies 3"]
    turn: Float[Array, "*bodies 4"]


class Known(NamedTuple):
    """What is known of bodies from the first instant: points, outward normals, what the points
    look like, pivot, and root mean square distance of the points from it."""

    place: Float[Array, "*bodies points 3"]
    normal: Float[Array, "*bodies points 3"]
    look: Float[Array, "*bodies points 5"]
    pivot: Float[Array, "*bodies 3"]
    size: Float[Array, "*bodies"]


class Sight(NamedTuple):
    """How every view sees the points of a body near a pose: where they are, their pixels, the
    pixels' slopes, how much they face the view, and whether it sees them."""

    place: Float[Array, "points 3"]
    pixel: Float[Array, "views points 2"]
    slope: Float[Array, "views points 2 3"]
    weight: Float[Array, "views points"]
    seen: Bool[Array, "views points"]


def track(
    bodies: Bodies,
    member: Int[np.ndarray, " gaussians"],
    place: Float[np.ndarray, "gaussians 3"],
    normal: Float[np.ndarray, "gaussians 3"],
    color: Float[np.ndarray, "gaussians 3"],
    look: Callable[[Int[np.ndarray, " frames"]], Shown],
    camera: Camera,
    *,
    options: TrackOptions,
    seed: int,
    report: Callable[[int], None] = lambda done: None,
) -> Bodies:
    """The bodies with path and turn set to the poses that explain the pictures best.

    `member` is the body of each Gaussian, `normal` its disc's axis (of either sign), `color` its
    linear-light colour at the first instant; `look` shows those of the training frames that it is
    asked for, `camera` (stacked) took them. What one body hides of another is left out. Poses are
    approximate (a tenth of a radian, a tenth of a size): a start for the fit. Bodies whose poses
    explain the pictures hardly better than rest are left out: a floor over which shadows pass
    changes too, but its colours stay where they are.
    """
    count, instants = bodies.pivot.shape[0], np.asarray(bodies.time)
    if not count or len(instants) < 2 or not options.poses:
        return bodies
    known = _known(bodies, member, place, normal, color, options.points, seed)
    shrink = max(1, min(camera.film.width, camera.film.height) // options.side)
    identity = jnp.zeros((count, 4), jnp.float32).at[:, 0].set(1)
    poses = [Pose(jnp.zeros((count, 3), jnp.float32), identity)]
    time, key = np.asarray(camera.time), jax.random.key(seed)
    mismatch = np.zeros((2, count))  # of the poses that are found, and of rest
    for i in range(1, len(instants)):
        own = np.flatnonzero(time == instants[i].astype(time.dtype))
        views = jax.tree.map(lambda x, own=own: x[own], camera)
        layers = appearance.layers(look(own), shrink, options.blur)
        starts = (_ahead(poses, instants[: i + 1]), poses[-1])
        keys = jax.random.split(jax.random.fold_in(key, i), count)
        poses.append(_search(keys, known, starts, views, layers, options, shrink))
        either = jax.tree.map(lambda *x: jnp.stack(x), poses[-1], poses[0])
        mismatch += np.asarray(_mismatch(either, poses[-1], known, views, layers[-1], shrink))
        report(i)
    path = jnp.stack([pose.path for pose in poses], axis=1).astype(bodies.path.dtype)
    turn = jnp.stack([pose.turn for pose in poses], axis=1).astype(bodies.turn.dtype)
    found = eqx.tree_at(lambda b: (b.path, b.turn), bodies, (path, turn))
    real = np.flatnonzero(mismatch[0] < WORTH * mismatch[1])
    return Bodies(**{n: x if n == "time" else x[real] for n, x in vars(found).items()})


def _known(bodies, member, place, normal, color, points: int, seed: int) -> Known:
    """Equally many points of every body, stacked."""
    dice, parts = np.random.default_rng(seed), []
    for i, pivot in enumerate(np.asarray(bodies.pivot)):
        own = np.flatnonzero(member == i)
        own = dice.choice(own, points, replace=len(own) < points)
        arm = place[own] - pivot
        outward = np.where(np.sum(arm * normal[own], axis=1, keepdims=True) < 0, -1, 1)
        size = np.sqrt(np.mean(np.sum(arm * arm, axis=1)))
        like = np.pad(appearance.look(color[own]), ((0, 0), (0, 1)), constant_values=CHANGES)
        parts.append((place[own], normal[own] * outward, like, pivot, size))
    return Known(*(jnp.asarray(np.stack(x), jnp.float32) for x in zip(*parts, strict=True)))


def _ahead(poses: list[Pose], instants: np.ndarray) -> Pose:
    """Where the last two poses lead at steady speed."""
    last = poses[-1]
    if len(poses) == 1:
        return last
    before = poses[-2]
    ahead = float((instants[-1] - instants[-2]) / (instants[-2] - instants[-3]))
    back = before.turn * jnp.asarray([[1, -1, -1, -1]], before.turn.dtype)
    step = multiply(last.turn, back)
    step = jnp.where(step[:, :1] < 0, -step, step)
    onward = (ahead * step).at[:, 0].add(1 - ahead)
    turn = normalize_quaternion(multiply(normalize_quaternion(onward), last.turn))
    return Pose(last.path + ahead * (last.path - before.path), turn)


@eqx.filter_jit
def _search(
    keys: Key[Array, " bodies"],
    known: Known,
    starts: tuple[Pose, ...],
    views: Camera,
    layers: list[Array],
    options: TrackOptions,
    shrink: int,
) -> Pose:
    """The best pose of every body near one of its starts."""

    def one(key: PRNGKeyArray, body: Array) -> Pose:
        found = [
            _from(key, body, known, start, i > 0, views, layers, options, shrink)
            for i, start in enumerate(starts)
        ]
        best = jnp.argmin(jnp.stack([cost for _, cost in found]))
        return jax.tree.map(lambda *x: jnp.stack(x)[best], *(pose for pose, _ in found))

    return jax.vmap(one)(keys, jnp.arange(len(keys)))


@eqx.filter_jit
def _mismatch(
    poses: Pose, found: Pose, known: Known, views: Camera, layer: Array, shrink: int
) -> Float[Array, "poses bodies"]:
    """Mean difference of colour and brightness of every body at poses, others being where they
    were `found`. That pixels change says nothing here: shadows make them do so, too."""
    known, layer = known._replace(look=known.look[..., :-1]), layer[..., :-1]

    def one(at: Pose, body: Array) -> Array:
        own = jax.tree.map(lambda x: x[body], known)
        sight = _sight(at, own, body, known, found, views, layer, shrink)
        return _cost(jnp.zeros(6, at.path.dtype), at, own, sight, layer)

    return jax.vmap(jax.vmap(one), (0, None))(poses, jnp.arange(len(known.size)))


def _from(key, body, known, start, lost, views, layers, options, shrink) -> tuple[Pose, Array]:
    """The best pose of one body that the search reaches from a start, and its cost. A body that may
    be `lost`, having been hit, is first looked for far around the start."""
    own, pose = (jax.tree.map(lambda x: x[body], tree) for tree in (known, start))
    dtype = pose.path.dtype
    unit = jnp.concatenate([jnp.ones(3, dtype), jnp.full(3, own.size)])
    spread, cost = jnp.full(6, WIDTHS[0][0], dtype), jnp.asarray(jnp.inf, dtype)

    def costs(draw: Array, pose: Pose, layer: Array) -> Array:
        sight = _sight(pose, own, body, known, start, views, layer, shrink)
        return jax.lax.map(lambda x: _cost(x, pose, own, sight, layer), draw, batch_size=32)

    if lost:
        draw = LOST * unit[None] * jax.random.normal(key, (FAR * options.poses, 6), dtype)
        pose = _changed(pose, draw[jnp.argmin(costs(draw, pose, layers[0]))])

    for level, layer in enumerate(layers):
        wide, narrow = WIDTHS[min(level, len(WIDTHS) - 1)]

        def one_round(state, key, layer=layer, narrow=narrow):
            pose, spread, _ = state
            draw = spread[None] * jax.random.normal(key, (options.poses, 6), dtype)
            draw = draw.at[0].set(0) * unit[None]
            cost = costs(draw, pose, layer)
            order = jnp.argsort(cost)[: options.elite]
            best = draw[order]
            spread = jnp.maximum(jnp.std(best, axis=0) / unit, narrow)
            return (_changed(pose, jnp.mean(best, axis=0)), spread, cost[order[0]]), None

        keys = jax.random.split(jax.random.fold_in(key, level), options.rounds)
        state = (pose, jnp.maximum(spread, wide), cost)
        (pose, spread, cost), _ = jax.lax.scan(one_round, state, keys)
    return pose, cost


def _changed(pose: Pose, change: Float[Array, "6"]) -> Pose:
    """Turned further by a rotation vector, then moved."""
    return Pose(pose.path + change[3:], multiply(turning(change[:3]), pose.turn))


def _place(pose: Pose, own: Known) -> Float[Array, "points 3"]:
    arm = product("ij,pj->pi", rotation_matrix(pose.turn), own.place - own.pivot[None])
    return (own.pivot + pose.path)[None] + arm


def _sight(pose, own, body, known, start, views, layer, shrink) -> Sight:
    """What is seen of a body at a pose, the others being where they start."""
    place = _place(pose, own)
    normal = product("ij,pj->pi", rotation_matrix(pose.turn), own.normal)
    others = known.pivot + start.path
    size = jnp.asarray(layer.shape[2:0:-1], place.dtype)

    def in_view(camera: Camera) -> tuple[Array, ...]:
        def pixel_of(point: Array) -> tuple[Array, Array]:
            pixel = project(camera, point) / shrink
            return pixel, pixel

        slope, pixel = jax.vmap(jax.jacfwd(pixel_of, has_aux=True))(place)
        eye = pose_at(camera.trajectory, camera.time).translation
        sight = eye[None] - place
        distance = jnp.sqrt(jnp.sum(sight * sight, axis=-1, keepdims=True))
        sight = sight / distance
        cosine = jnp.sum(sight * normal, axis=-1)
        fine = jnp.all(jnp.isfinite(slope), axis=(-1, -2)) & jnp.all(jnp.isfinite(pixel), axis=-1)
        inside = fine & jnp.all((pixel >= 0) & (pixel <= size[None]), axis=-1)
        # A body hides what is behind the ball that it nearly fills.
        across = others[None] - place[:, None]
        along = jnp.sum(across * sight[:, None], axis=-1)
        square = jnp.sum(across * across, axis=-1) - along * along
        hidden = (along > 0) & (along < distance) & (square < (0.8 * known.size[None]) ** 2)
        hidden = jnp.any(hidden & (jnp.arange(len(others)) != body)[None], axis=-1)
        pixel, slope = jnp.where(fine[:, None], pixel, 0), jnp.where(fine[:, None, None], slope, 0)
        return pixel, slope, jnp.where(cosine > GRAZING, cosine, 0), inside & ~hidden

    return Sight(place, *jax.vmap(in_view)(views))


def _cost(change, pose, own, sight: Sight, layer) -> Float[Array, ""]:
    """Mean difference between the points and the pixels they fall on after a change of pose."""
    shift = _place(_changed(pose, change), own) - sight.place
    pixel = sight.pixel + product("vpij,pj->vpi", sight.slope, shift)
    last = jnp.asarray(layer.shape[2:0:-1]) - 1
    column, row = jnp.moveaxis(jnp.clip(pixel.astype(jnp.int32), 0, last[None, None]), -1, 0)
    found = layer[jnp.arange(layer.shape[0])[:, None], row, column]
    difference = jnp.sum(jnp.abs(found - own.look[None]), axis=-1) / 3
    # Points that are hidden or out of the picture are no reason to go there, nor to leave.
    told = sight.seen & ~jnp.isnan(difference)
    difference = jnp.where(told, jnp.minimum(difference, MISMATCH), MISMATCH / 2)
    return jnp.sum(sight.weight * difference) / jnp.sum(sight.weight)
