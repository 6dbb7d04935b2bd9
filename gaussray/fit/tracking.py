"""Where the bodies are at every instant, found in the pictures before anything is optimised.

A fit by gradients finds a pose only from nearby: a wedge of a ball must still overlap itself. Here
the pose of each body is searched for instead, instant after instant, by the cross-entropy method:
draw poses, keep those under which the body's points fall on pixels of their own colour, draw again
around them, first in blurred pictures, then in sharp ones. Colours are compared without their
brightness, because what turns under a lamp changes its brightness more than its colour.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.ndimage import gaussian_filter

from gaussray.camera.camera import Camera, project
from gaussray.color import srgb_decode
from gaussray.geometry import multiply, normalize_quaternion, rotation_matrix, turning
from gaussray.scene.bodies import Bodies


class TrackOptions(eqx.Module):
    """How thoroughly poses are searched for.

    `points` of each body are looked up under `poses` poses per round; the best `elite` lead to the
    next. `rounds` are made at each of the blurs `blur` (standard deviations in pixels of pictures
    shrunk to about `side` pixels). No body is tracked if `poses` is 0.
    """

    points: int = eqx.field(static=True, default=100)
    poses: int = eqx.field(static=True, default=128)
    elite: int = eqx.field(static=True, default=12)
    rounds: int = eqx.field(static=True, default=4)
    blur: tuple[float, ...] = eqx.field(static=True, default=(4.0, 2.0, 0.7))
    side: int = eqx.field(static=True, default=128)

    def __check_init__(self):
        for name in ("points", "rounds", "side"):
            if getattr(self, name) < 1:
                raise ValueError(f"track.{name} must be at least 1, got {getattr(self, name)}.")
        if self.poses and not 1 < self.elite < self.poses:
            raise ValueError(
                f"track.elite must be between 1 and track.poses, got {self.elite} of {self.poses}."
            )


class Body(NamedTuple):
    """What is known of a body at the first instant: points, outward normals, colours."""

    place: Float[Array, "points 3"]
    normal: Float[Array, "points 3"]
    hue: Float[Array, "points 5"]
    pivot: Float[Array, "3"]
    size: Float[Array, ""]


class Pose(NamedTuple):
    """Displacement of the pivot and turn about it, since the first instant."""

    path: Float[Array, "3"]
    turn: Float[Array, "4"]


# A point counts in pictures that see its side by more than this cosine.
GRAZING = 0.25
# Larger differences of colour say that something else is in front.
MISMATCH = 0.3
# Linear light below which a colour means little, and how much brightness counts beside colour.
DARK, BRIGHTNESS = 0.005, 0.1
# How much it counts that a pixel changes at all.
MOVED = 0.3


def track(
    bodies: Bodies,
    member: Int[np.ndarray, " gaussians"],
    place: Float[np.ndarray, "gaussians 3"],
    normal: Float[np.ndarray, "gaussians 3"],
    color: Float[np.ndarray, "gaussians 3"],
    picture: np.ndarray,
    moved: Bool[np.ndarray, "frames h w"],
    camera: Camera,
    *,
    options: TrackOptions,
    seed: int,
    report: Callable[[int], None] = lambda done: None,
) -> Bodies:
    """The bodies with path and turn set to the poses that explain the pictures best.

    `member` is the body of each Gaussian, `normal` its disc's axis (of either sign), `color` its
    linear-light colour at the first instant; `picture` (frames x height x width x 3, sRGB-encoded)
    and `camera` (stacked) are the training frames. What one body hides of another is left out.
    """
    count, instants = bodies.pivot.shape[0], np.asarray(bodies.time)
    if not count or len(instants) < 2 or not options.poses:
        return bodies
    dice = np.random.default_rng(seed)
    cast = _cast(bodies, member, place, normal, color, options, dice)
    key = jax.random.key(seed)
    shrink = max(1, min(picture.shape[1:3]) // options.side)
    identity = jnp.zeros((count, 4)).at[:, 0].set(1)
    poses = [Pose(jnp.zeros((count, 3)), identity)]
    time = np.asarray(camera.time)
    for i in range(1, len(instants)):
        own = np.flatnonzero(time == instants[i].astype(time.dtype))
        views = jax.tree.map(lambda x, own=own: x[own], camera)
        sharp = _shrunk(picture[own], shrink)
        hue = np.concatenate(
            [_hue(sharp), MOVED * _shrunk(moved[own, :, :, None], shrink)], axis=-1
        )
        layers = [jnp.asarray(_blurred(hue, s)) for s in options.blur]
        starts = (_ahead(poses, instants[: i + 1]), *poses[-1:][: i > 1])
        keys = jax.random.split(jax.random.fold_in(key, i), count)
        poses.append(_search(keys, cast, starts, views, layers, options, shrink))
        report(i)
    path = jnp.stack([pose.path for pose in poses], axis=1)
    turn = jnp.stack([pose.turn for pose in poses], axis=1)
    return eqx.tree_at(lambda b: (b.path, b.turn), bodies, (path, turn))


def _cast(bodies, member, place, normal, color, options, dice) -> Body:
    """Equally many points of every body, stacked."""
    parts = []
    for i, pivot in enumerate(np.asarray(bodies.pivot)):
        own = np.flatnonzero(member == i)
        own = dice.choice(own, options.points, replace=len(own) < options.points)
        arm = place[own] - pivot
        outward = np.where(np.sum(arm * normal[own], axis=1, keepdims=True) < 0, -1, 1)
        size = np.sqrt(np.mean(np.sum(arm * arm, axis=1)))
        hue = np.pad(_hue_of_light(color[own]), ((0, 0), (0, 1)), constant_values=MOVED)
        parts.append(Body(place[own], normal[own] * outward, hue, pivot, size))
    return jax.tree.map(lambda *x: jnp.asarray(np.stack(x), jnp.float32), *parts)


def _ahead(poses: list[Pose], instants: np.ndarray) -> Pose:
    """Where the last two poses lead at steady speed."""
    last = poses[-1]
    if len(poses) == 1:
        return last
    before = poses[-2]
    ahead = float((instants[-1] - instants[-2]) / (instants[-2] - instants[-3]))
    conjugate = jnp.asarray([1.0, -1.0, -1.0, -1.0])
    step = multiply(last.turn, before.turn * conjugate)
    step = jnp.where(step[:, :1] < 0, -step, step)
    onward = normalize_quaternion(jnp.asarray([1.0, 0, 0, 0]) * (1 - ahead) + ahead * step)
    turn = normalize_quaternion(multiply(onward, last.turn))
    return Pose(last.path + ahead * (last.path - before.path), turn)


@eqx.filter_jit
def _search(keys, cast: Body, starts: tuple[Pose, ...], views, layers, options, shrink: int):
    """The best pose of every body near one of its starts."""

    def one(key, i):
        found = [_from(key, i, cast, start, views, layers, options, shrink) for start in starts]
        cost = jnp.stack([cost for _, cost in found])
        pose = jax.tree.map(lambda *x: jnp.stack(x)[jnp.argmin(cost)], *(pose for pose, _ in found))
        return pose

    return jax.vmap(one)(keys, jnp.arange(len(keys)))


def _from(key, i, cast, start, views, layers, options, shrink):
    body = jax.tree.map(lambda x: x[i], cast)
    center = cast.pivot + start.path
    pose = jax.tree.map(lambda x: x[i], start)
    unit = jnp.concatenate([jnp.ones(3), jnp.full(3, body.size)])
    cost = jnp.inf
    # Radians of turn and body sizes of path: how wide a level begins, and ends at least.
    widths = ((0.35, 0.05), (0.1, 0.02), (0.05, 0.005))
    spread = jnp.full(6, 0.35)
    for level, layer in enumerate(layers):
        wide, narrow = widths[min(level, 2)]
        spread = jnp.maximum(spread, wide)

        def one_round(state, key, layer=layer, narrow=narrow):
            pose, spread, _ = state
            draw = spread * jax.random.normal(key, (options.poses, 6))
            draw = draw.at[0].set(0) * unit
            sight = _sight(pose, body, i, center, cast.size, views, layer, shrink)
            cost = jax.lax.map(
                lambda z: _mismatch(z, pose, body, sight, layer), draw, batch_size=32
            )
            order = jnp.argsort(cost)[: options.elite]
            best = draw[order]
            spread = jnp.maximum(jnp.std(best, 0) / unit, narrow)
            return (_moved(pose, jnp.mean(best, 0)), spread, cost[order[0]]), None

        keys = jax.random.split(jax.random.fold_in(key, level), options.rounds)
        (pose, spread, cost), _ = jax.lax.scan(one_round, (pose, spread, cost), keys)
    return pose, cost


def _moved(pose: Pose, change: Float[Array, "6"]) -> Pose:
    return Pose(pose.path + change[3:], multiply(turning(change[:3]), pose.turn))


def _placed(pose: Pose, body: Body) -> Array:
    return body.pivot + pose.path + (body.place - body.pivot) @ rotation_matrix(pose.turn).T


class Sight(NamedTuple):
    """How every view sees the points of a body near a pose: pixels, their slopes, weights."""

    place: Float[Array, "points 3"]
    pixel: Float[Array, "views points 2"]
    slope: Float[Array, "views points 2 3"]
    weight: Float[Array, "views points"]


def _sight(pose, body, own, center, size, views, layer, shrink) -> Sight:
    place = _placed(pose, body)
    normal = body.normal @ rotation_matrix(pose.turn).T
    bounds = jnp.asarray(layer.shape[2:0:-1])

    def in_view(camera):
        def pixel_of(point):
            pixel = project(camera, point) / shrink
            return pixel, pixel

        slope, pixel = jax.vmap(jax.jacfwd(pixel_of, has_aux=True))(place)
        eye = camera.trajectory.translation[0]
        sight = eye - place
        distance = jnp.linalg.norm(sight, axis=-1, keepdims=True)
        sight = sight / distance
        cosine = jnp.sum(sight * normal, axis=-1)
        fine = jnp.all(jnp.isfinite(slope), axis=(-1, -2)) & jnp.all(jnp.isfinite(pixel), axis=-1)
        inside = fine & jnp.all((pixel >= 0) & (pixel <= bounds), axis=-1)
        # A body hides what is behind the ball that it nearly fills.
        to_center = center[None] - place[:, None]
        along = jnp.sum(to_center * sight[:, None], axis=-1)
        square = jnp.sum(to_center**2, axis=-1) - along**2
        hidden = (along > 0) & (along < distance) & (square < (0.8 * size) ** 2)
        hidden = jnp.any(hidden & (jnp.arange(center.shape[0]) != own), axis=-1)
        seen = inside & ~hidden & (cosine > GRAZING)
        pixel, slope = jnp.where(fine[:, None], pixel, 0), jnp.where(fine[:, None, None], slope, 0)
        return pixel, slope, jnp.where(seen, cosine, 0)

    return Sight(place, *jax.vmap(in_view)(views))


def _mismatch(change, pose, body, sight: Sight, layer):
    """Mean difference between the points' colours and those of the pixels they fall on."""
    shift = _placed(_moved(pose, change), body) - sight.place
    pixel = sight.pixel + jnp.einsum("vpij,pj->vpi", sight.slope, shift)
    limit = jnp.asarray(layer.shape[2:0:-1]) - 1
    column, row = jnp.moveaxis(jnp.clip(pixel.astype(jnp.int32), 0, limit), -1, 0)
    found = layer[jnp.arange(layer.shape[0])[:, None], row, column]
    difference = jnp.sum(jnp.abs(found - body.hue), axis=-1)
    total = jnp.sum(sight.weight * jnp.minimum(difference / 3, MISMATCH))
    return total / jnp.maximum(jnp.sum(sight.weight), 1e-3)


def _shrunk(picture: np.ndarray, factor: int) -> np.ndarray:
    """Means of blocks of factor x factor pixels; values in [0, 1]."""
    scale = 255 if picture.dtype == np.uint8 else 1
    frames, height, width, channels = picture.shape
    height, width = height // factor, width // factor
    block = picture[:, : height * factor, : width * factor].astype(np.float32) / scale
    return block.reshape(frames, height, factor, width, factor, channels).mean(axis=(2, 4))


def _blurred(picture: np.ndarray, sigma: float) -> np.ndarray:
    return gaussian_filter(picture, (0, sigma, sigma, 0))


def _hue(encoded: np.ndarray) -> np.ndarray:
    return _hue_of_light(srgb_decode(encoded))


def _hue_of_light(light: np.ndarray) -> np.ndarray:
    """Colour without brightness (r, g, b over their mean) and a little of the brightness."""
    light = np.maximum(light, 0)
    mean = light.mean(axis=-1, keepdims=True)
    return np.concatenate([0.4 * light / (mean + DARK), BRIGHTNESS * np.sqrt(mean)], axis=-1)
