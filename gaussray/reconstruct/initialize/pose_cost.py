"""How well a rigid body at a pose agrees with the pictures of one time.

A pose costs the mean difference between the points of a body and the pixels they fall on.
Brightness counts little in it, because a body that turns under a lamp changes its brightness more
than its colour; that a pixel changes at all counts much.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from gaussray.camera.camera import Camera, project
from gaussray.camera.trajectory import pose_at
from gaussray.geometry import multiply, product, rotation_matrix, turning


# A point counts in pictures that see its side by more than this cosine.
GRAZING = 0.25
# A larger difference says that something else is in front, not how much it differs.
MISMATCH = 0.3
# Added to what is seen of a body: this part of its points, with this difference. The right pose
# differs by 0.1, a wrong one by 0.2.
DOUBT, UNSEEN = 0.3, 0.2
# A point looks as the pictures show it if colour and brightness differ by less: those of points
# that stereo has found do by 0.015 in the median.
SAME_LOOK = 0.05


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
    """How every view sees the points of a body near a pose: where they are, their outward normals,
    the direction to the view, their pixels, the pixels' slopes, whether the view
    sees them, and whether they would cover a body that was found."""

    place: Float[Array, "points 3"]
    normal: Float[Array, "points 3"]
    sight: Float[Array, "views points 3"]
    pixel: Float[Array, "views points 2"]
    slope: Float[Array, "views points 2 3"]
    seen: Bool[Array, "views points"]
    covers: Bool[Array, "views points"]


class Pictures(NamedTuple):
    """What the cameras `views` show, at every blur, `shrink` times smaller."""

    views: Camera
    layers: list[Array]
    shrink: int


class Mismatch(NamedTuple):
    """How much bodies differ from the pictures: at their poses, at rest, and by the motion of each
    other body (row), as if they were parts of it; and every point, summed over the views that see
    it, at its pose and at rest, with the weights of these views."""

    moved: Float[np.ndarray | Array, " bodies"]
    rests: Float[np.ndarray | Array, " bodies"]
    others: Float[np.ndarray | Array, "bodies bodies"]
    point: Float[np.ndarray | Array, "2 bodies points"]
    weight: Float[np.ndarray | Array, "2 bodies points"]


def rest_pose(known: Known) -> Pose:
    """The pose of all bodies at the first time."""
    turn = jnp.zeros((len(known.size), 4), known.pivot.dtype).at[:, 0].set(1)
    return Pose(jnp.zeros_like(known.pivot), turn)


def none_found(pose: Pose, known: Known) -> Others:
    """Bodies at their poses, none of which was found.

    Args:
        pose: where they are taken to be.
        known: the bodies at the first time.
    """
    # Not a constant: XLA would spend seconds on what follows from it for every pose.
    return Others(pose, known.size < 0)


@eqx.filter_jit
def mismatch_at(pose: Pose, known: Known, pictures: Pictures) -> Mismatch:
    """Mean differences of colour and brightness of all bodies at a time, in the sharpest pictures.
    That pixels change says nothing here: shadows make them do so, too.

    Args:
        pose: where the bodies are found at that time.
        known: the bodies at the first time.
        pictures: what the cameras show at that time.
    """
    sharpest, count = pictures.layers[-1][..., :-1], len(known.size)
    known = known._replace(look=known.look[..., :-1])
    others = none_found(pose, known)

    def one(body: Array, at: Pose) -> tuple[Array, Array, Array]:
        own = jax.tree.map(lambda x: x[body], known)
        visible = visibility(at, own, body, known, others, pictures, sharpest)
        _, counted, difference = _differences(visible, own, sharpest)
        point = jnp.sum(jnp.where(counted > 0, counted * difference, 0), axis=0)
        return cost_as_seen(visible, own, sharpest), point, jnp.sum(counted, axis=0)

    def as_parts_of(body: Array) -> Array:
        of = jax.tree.map(lambda x: x[body], pose)
        arm = known.pivot - known.pivot[body][None]
        turned = product("ij,bj->bi", rotation_matrix(of.turn), arm)
        at = Pose(of.path[None] + turned - arm, jnp.broadcast_to(of.turn[None], pose.turn.shape))
        return jax.vmap(one)(jnp.arange(count), at)[0]

    both = [jax.vmap(one)(jnp.arange(count), at) for at in (pose, rest_pose(known))]
    (moved, rests), point, weight = (jnp.stack(x) for x in zip(*both, strict=True))
    return Mismatch(moved, rests, jax.lax.map(as_parts_of, jnp.arange(count)), point, weight)


@eqx.filter_jit
def toward_views(known: Known, pictures: Pictures) -> Known:
    """The bodies, with the normals of some points turned over: those that face no view, though most
    views of their other side show them, as they do that of a floor below a ball.

    Args:
        known: the bodies at the first time, with outward normals.
        pictures: what the cameras show at the first time.
    """
    sharpest, count = pictures.layers[-1][..., :-1], len(known.size)
    rest = rest_pose(known)
    others = none_found(rest, known)

    def one(body: Array, pose: Pose) -> Array:
        own = jax.tree.map(lambda x: x[body], known._replace(look=known.look[..., :-1]))
        visible = visibility(pose, own, body, known, others, pictures, sharpest)
        _, counted, _ = _differences(visible, own, sharpest)
        _, over, difference = _differences(visible._replace(normal=-visible.normal), own, sharpest)
        alike = jnp.sum(jnp.where(difference < SAME_LOOK, over, 0), axis=0)
        turned = (jnp.sum(counted, axis=0) == 0) & (alike > jnp.sum(over, axis=0) / 2)
        return jnp.where(turned[:, None], -own.normal, own.normal)

    return known._replace(normal=jax.vmap(one)(jnp.arange(count), rest))


def changed(pose: Pose, change: Float[Array, "6"]) -> Pose:
    """A pose turned further, then moved.

    Args:
        pose: the pose of one body.
        change: rotation vector in radians, then the step.
    """
    return Pose(pose.path + change[3:], multiply(turning(change[:3]), pose.turn))


def _place(pose: Pose, own: Known) -> Float[Array, "points 3"]:
    arm = product("ij,pj->pi", rotation_matrix(pose.turn), own.place - own.pivot[None])
    return (own.pivot + pose.path)[None] + arm


def visibility(pose, own, body, known, others, pictures, layer) -> Visibility:
    """How the views see a body at a pose, with the other bodies where they are taken to be.

    Args:
        pose: the pose of the body.
        own: the body's points.
        body: its number.
        known: all bodies.
        others: where they are meanwhile.
        pictures: cameras and pictures of the time.
        layer: the pictures at one blur.
    """
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
        slope = jnp.where(jnp.isfinite(slope), slope, 0)
        fine = jnp.all(jnp.isfinite(pixel), axis=-1)
        inside = fine & jnp.all((pixel >= 0) & (pixel <= size[None]), axis=-1)
        # A body occludes what is behind a ball of 0.8 of its size.
        across = middle[None] - place[:, None]
        along = jnp.sum(across * sight[:, None], axis=-1)
        square = jnp.sum(across * across, axis=-1) - along * along
        meets = another & (along < distance) & (square < (0.8 * known.size[None]) ** 2)
        seen = inside & ~jnp.any(meets & (along > 0), axis=-1)
        covers = seen & jnp.any(meets & (along <= 0) & others.found[None], axis=-1)
        return sight, jnp.where(fine[:, None], pixel, 0), slope, seen, covers

    return Visibility(place, normal, *jax.vmap(in_view)(pictures.views))


def pose_cost(change, pose, own, visible: Visibility, layer) -> Float[Array, ""]:
    """Mean difference between the points and the pixels they fall on after a change of pose.

    Args:
        change: rotation vector in radians, then the step.
        pose: the pose before.
        own: the body's points.
        visible: how the views see them at the pose before.
        layer: the pictures at one blur.
    """
    shift = _place(changed(pose, change), own) - visible.place
    pixel = visible.pixel + product("vpij,pj->vpi", visible.slope, shift)
    normal = product("ij,pj->pi", rotation_matrix(turning(change[:3])), visible.normal)
    return cost_as_seen(visible._replace(pixel=pixel, normal=normal), own, layer)


def cost_as_seen(visible: Visibility, own: Known, layer: Array) -> Float[Array, ""]:
    """Mean difference between the points and the pixels they fall on.

    Args:
        visible: how the views see the points.
        own: the body's points.
        layer: the pictures at one blur.
    """
    weight, counted, difference = _differences(visible, own, layer)
    # Occluded points and those out of the picture do not count; a few of all points count as if
    # they differed, so that a body that is hidden from most views has little to show for itself.
    doubt = DOUBT * jnp.sum(weight)
    total = jnp.sum(jnp.where(counted > 0, counted * difference, 0)) + doubt * UNSEEN
    faces_any = doubt > 0
    cost = total / jnp.where(faces_any, jnp.sum(counted) + doubt, 1)
    return jnp.where(faces_any, cost, MISMATCH)


def _differences(
    visible: Visibility, own: Known, layer: Array
) -> tuple[
    Float[Array, "views points"], Float[Array, "views points"], Float[Array, "views points"]
]:
    """How much each view faces each point, how much of that counts, and how much both differ."""
    last = jnp.asarray(layer.shape[2:0:-1]) - 1
    pixel = jnp.clip(visible.pixel.astype(jnp.int32), 0, last[None, None])
    column, row = jnp.moveaxis(pixel, -1, 0)
    found = layer[jnp.arange(layer.shape[0])[:, None], row, column]
    cosine = jnp.sum(visible.sight * visible.normal[None], axis=-1)
    weight = jnp.where(cosine > GRAZING, cosine, 0)
    difference = jnp.sum(jnp.abs(found - own.look[None]), axis=-1) / 3
    counted = jnp.where(visible.seen & ~jnp.isnan(difference), weight, 0)
    return weight, counted, jnp.where(visible.covers, MISMATCH, jnp.minimum(difference, MISMATCH))
