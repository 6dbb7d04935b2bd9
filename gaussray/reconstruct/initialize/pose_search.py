"""The pose of a rigid body at one time, searched for by the cross-entropy method.

Draw poses, keep those under which the body's points fall on pixels that look like them, draw again
around these, first in blurred pictures, then in sharp ones. Brightness counts little, because a
body that turns under a lamp changes its brightness more than its colour; that a pixel changes at
all counts much.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key, PRNGKeyArray

from gaussray.camera.camera import Camera, project
from gaussray.camera.trajectory import pose_at
from gaussray.geometry import multiply, product, rotation_matrix, turning


class TrackOptions(eqx.Module):
    """How thoroughly poses of rigid bodies are searched for.

    Args:
        poses: poses that are tried in a round; 0: no tracking.
        points: points of a body that are compared with the pictures under each pose.
        elite: the best poses, around which the next round searches.
        rounds: rounds at each blur.
        blur: standard deviations of the blurs in pixels, one after another.
        side: pictures are shrunk to about this many pixels on their shorter side.

    Raises:
        ValueError: a value is out of its range.
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


# Of poses that look alike, as those of a grey box do, the nearest is right: what a change by one
# radian or by the body's own size, since the start of the search, adds to the cost. That is a
# difference of colour, of which an 8-bit picture tells 0.004.
FARTHER = 0.003
# A point counts in pictures that see its side by more than this cosine.
GRAZING = 0.25
# A larger difference says that something else is in front, not how much it differs.
MISMATCH = 0.3
# Standard deviations, in radians of turn and body sizes of path, with which the search at each blur
# begins, and the least with which it ends; the last pair holds for all further blurs.
WIDTHS = ((0.35, 0.05), (0.1, 0.02), (0.05, 0.005))
# Standard deviation, and factor of the number of poses, of the search for a body that was hit.
LOST, FAR = 0.8, 4
# A blow may turn a body by any angle: so many turns are tried where it is found in blurred
# pictures. They are Cauchy distributed with this half width in radians, each with a small step of
# its place, in body sizes.
TURNS, SPUN, NUDGED = 512, 0.5, 0.1


class Pose(NamedTuple):
    """Displacement of a body's pivot and turn about it, since the first instant."""

    path: Float[Array, "*bodies 3"]
    turn: Float[Array, "*bodies 4"]


class Known(NamedTuple):
    """Bodies at the first time: points, outward normals, what the points
    look like, pivot, and root mean square distance of the points from it."""

    place: Float[Array, "*bodies points 3"]
    normal: Float[Array, "*bodies points 3"]
    look: Float[Array, "*bodies points 5"]
    pivot: Float[Array, "*bodies 3"]
    size: Float[Array, "*bodies"]


class Others(NamedTuple):
    """Where all bodies are taken to be while one is searched for, and which of them were found:
    what a view shows in the place of a found body is that body, and no other one before it."""

    pose: Pose
    found: Bool[Array, "*bodies"]


class Visibility(NamedTuple):
    """How every view sees the points of a body near a pose: where they are, their pixels, the
    pixels' slopes, how much they face the view, whether it sees them, and whether they would cover
    a body that was found."""

    place: Float[Array, "points 3"]
    pixel: Float[Array, "views points 2"]
    slope: Float[Array, "views points 2 3"]
    weight: Float[Array, "views points"]
    seen: Bool[Array, "views points"]
    covers: Bool[Array, "views points"]


class Start(NamedTuple):
    """Where a search begins, and where the other bodies are meanwhile. A body that may be `lost`,
    having been hit, is first looked for far around the pose."""

    pose: Pose
    lost: bool
    others: Others


class Pictures(NamedTuple):
    """What the cameras `views` show, at every blur, `shrink` times smaller."""

    views: Camera
    layers: list[Array]
    shrink: int


@eqx.filter_jit
def search_poses(
    keys: Key[Array, " bodies"],
    known: Known,
    starts: tuple[Pose, ...],
    others: tuple[Others, ...],
    pictures: Pictures,
    options: TrackOptions,
) -> tuple[Pose, Float[Array, " bodies"]]:
    """The best pose of every body near one of its starts, and its cost.

    Args:
        keys: random keys of the poses to try.
        known: the bodies at the first time.
        starts: poses of all bodies around which to search; from the second on, a body may have
            been hit and is looked for far around.
        others: for each start, where the other bodies are meanwhile.
        pictures: what the cameras show at the time of the poses.
        options: how thoroughly to search.
    """

    def one(key: PRNGKeyArray, body: Array) -> tuple[Pose, Array]:
        found = [
            _search_from(key, body, known, Start(start, i > 0, other), pictures, options)
            for i, (start, other) in enumerate(zip(starts, others, strict=True))
        ]
        cost = jnp.stack([cost for _, cost in found])
        best = jnp.argmin(cost)
        pose = jax.tree.map(lambda *x: jnp.stack(x)[best], *(pose for pose, _ in found))
        return pose, cost[best]

    return jax.vmap(one)(keys, jnp.arange(len(keys)))


@eqx.filter_jit
def mismatch_at(
    poses: Pose, found: Pose, known: Known, pictures: Pictures
) -> Float[Array, "poses bodies"]:
    """Mean difference of colour and brightness of every body at poses, in the sharpest pictures.
    That pixels change says nothing here: shadows make them do so, too.

    Args:
        poses: poses of all bodies, stacked.
        found: where the other bodies are meanwhile.
        known: the bodies at the first time.
        pictures: what the cameras show at the time of the poses.
    """
    sharpest = pictures.layers[-1][..., :-1]
    known = known._replace(look=known.look[..., :-1])
    others = Others(found, jnp.zeros(len(known.size), bool))

    def one(at: Pose, body: Array) -> Array:
        own = jax.tree.map(lambda x: x[body], known)
        visible = _visibility(at, own, body, known, others, pictures, sharpest)
        return _cost(jnp.zeros(6, at.path.dtype), at, own, visible, sharpest)

    return jax.vmap(jax.vmap(one), (0, None))(poses, jnp.arange(len(known.size)))


def _search_from(
    key: PRNGKeyArray,
    body: Array,
    known: Known,
    start: Start,
    pictures: Pictures,
    options: TrackOptions,
) -> tuple[Pose, Array]:
    """The best pose of one body that the search reaches from a start, and its cost."""
    layers = pictures.layers
    own, pose = (jax.tree.map(lambda x: x[body], tree) for tree in (known, start.pose))
    first, dtype = pose, pose.path.dtype
    unit = jnp.concatenate([jnp.ones(3, dtype), jnp.full(3, own.size)])
    spread, cost = jnp.full(6, WIDTHS[0][0], dtype), jnp.asarray(jnp.inf, dtype)

    def costs(draw: Array, pose: Pose, layer: Array) -> Array:
        visible = _visibility(pose, own, body, known, start.others, pictures, layer)

        def cost(change: Array) -> Array:
            farther = _change_from(first, _changed(pose, change), own.size)
            return _cost(change, pose, own, visible, layer) + FARTHER * farther

        return jax.lax.map(cost, draw, batch_size=32)

    if start.lost:
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

        if start.lost and level == min(1, len(layers) - 1):
            draw = _turns(jax.random.fold_in(key, len(layers)), own.size, dtype)
            pose = _changed(pose, draw[jnp.argmin(costs(draw, pose, layer))])
        keys = jax.random.split(jax.random.fold_in(key, level), options.rounds)
        state = (pose, jnp.maximum(spread, wide), cost)
        (pose, spread, cost), _ = jax.lax.scan(one_round, state, keys)
    return pose, cost


def _turns(key: PRNGKeyArray, size: Array, dtype) -> Float[Array, "turns 6"]:
    """Changes of a pose: turns of any angle, with small steps; the first changes nothing."""
    draw = jax.random.normal(key, (TURNS, 7), dtype).at[0, :6].set(0)
    turn = SPUN * draw[:, :3] / jnp.maximum(jnp.abs(draw[:, 6:]), 1e-6)
    return jnp.concatenate([turn, NUDGED * size * draw[:, 3:6]], axis=1)


def _changed(pose: Pose, change: Float[Array, "6"]) -> Pose:
    """Turned further by a rotation vector, then moved."""
    return Pose(pose.path + change[3:], multiply(turning(change[:3]), pose.turn))


def _change_from(first: Pose, pose: Pose, size: Array) -> Float[Array, ""]:
    """Radians, and body sizes, from one pose to another."""
    along = jnp.abs(jnp.sum(first.turn * pose.turn))
    across = jnp.linalg.norm(first.turn) * jnp.linalg.norm(pose.turn)
    angle = 2 * jnp.arccos(jnp.clip(along / across, 0, 1))
    return angle + jnp.linalg.norm(pose.path - first.path) / size


def _place(pose: Pose, own: Known) -> Float[Array, "points 3"]:
    arm = product("ij,pj->pi", rotation_matrix(pose.turn), own.place - own.pivot[None])
    return (own.pivot + pose.path)[None] + arm


def _visibility(pose, own, body, known, others, pictures, layer) -> Visibility:
    """How the views see a body at a pose, with the other bodies where they are taken to be."""
    place = _place(pose, own)
    normal = product("ij,pj->pi", rotation_matrix(pose.turn), own.normal)
    middle = known.pivot + others.pose.path
    another = (jnp.arange(len(middle)) != body)[None]
    size = jnp.asarray(layer.shape[2:0:-1], place.dtype)

    def in_view(camera: Camera) -> tuple[Array, ...]:
        def pixel_of(point: Array) -> tuple[Array, Array]:
            pixel = project(camera, point) / pictures.shrink
            return pixel, pixel

        slope, pixel = jax.vmap(jax.jacfwd(pixel_of, has_aux=True))(place)
        eye = pose_at(camera.trajectory, camera.time).translation
        sight = eye[None] - place
        distance = jnp.sqrt(jnp.sum(sight * sight, axis=-1, keepdims=True))
        sight = sight / distance
        cosine = jnp.sum(sight * normal, axis=-1)
        fine = jnp.all(jnp.isfinite(slope), axis=(-1, -2)) & jnp.all(jnp.isfinite(pixel), axis=-1)
        inside = fine & jnp.all((pixel >= 0) & (pixel <= size[None]), axis=-1)
        # A body occludes what is behind a ball of 0.8 of its size.
        across = middle[None] - place[:, None]
        along = jnp.sum(across * sight[:, None], axis=-1)
        square = jnp.sum(across * across, axis=-1) - along * along
        meets = another & (along < distance) & (square < (0.8 * known.size[None]) ** 2)
        seen = inside & ~jnp.any(meets & (along > 0), axis=-1)
        covers = seen & jnp.any(meets & (along <= 0) & others.found[None], axis=-1)
        pixel, slope = jnp.where(fine[:, None], pixel, 0), jnp.where(fine[:, None, None], slope, 0)
        return pixel, slope, jnp.where(cosine > GRAZING, cosine, 0), seen, covers

    return Visibility(place, *jax.vmap(in_view)(pictures.views))


def _cost(change, pose, own, visible: Visibility, layer) -> Float[Array, ""]:
    """Mean difference between the points and the pixels they fall on after a change of pose."""
    shift = _place(_changed(pose, change), own) - visible.place
    pixel = visible.pixel + product("vpij,pj->vpi", visible.slope, shift)
    last = jnp.asarray(layer.shape[2:0:-1]) - 1
    column, row = jnp.moveaxis(jnp.clip(pixel.astype(jnp.int32), 0, last[None, None]), -1, 0)
    found = layer[jnp.arange(layer.shape[0])[:, None], row, column]
    difference = jnp.sum(jnp.abs(found - own.look[None]), axis=-1) / 3
    # Occluded points and points out of the picture count as an average mismatch, so that they
    # neither attract nor repel.
    counted = visible.seen & ~jnp.isnan(difference)
    difference = jnp.where(counted, jnp.minimum(difference, MISMATCH), MISMATCH / 2)
    difference = jnp.where(visible.covers, MISMATCH, difference)
    return jnp.sum(visible.weight * difference) / jnp.sum(visible.weight)
