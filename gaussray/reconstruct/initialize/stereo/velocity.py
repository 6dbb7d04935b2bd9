"""Velocities of moving points: patches of one timestamp's points registered with the next one's."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.spatial import KDTree

from gaussray.geometry import normalize_quaternion, product, rotation_matrix


# What stands for rows without a point: far from every point, in any unit of the features.
_NOWHERE = 1e4
# Distances between features beyond which a point counts as lost, not as so much worse.
_LOST = 3.0


class RegistrationOptions(eqx.Module):
    """Settings of patch registration.

    `seeds` patches of `patch` neighbouring points each try `hypotheses` displacements, to points of
    like colour; the `best` ones are refined by rigid ICP over positions and colours. Colours that
    differ by `color` are as unlike as places one gap between points apart. Every point then chooses
    among the motions of its `around` nearest patches by its own `own` nearest points. At most
    `points` points of a timestamp are used; the others move as the nearest of these. `at_once`
    patches are registered at a time.
    """

    seeds: int = eqx.field(static=True, default=256)
    patch: int = eqx.field(static=True, default=48)
    hypotheses: int = eqx.field(static=True, default=40)
    best: int = eqx.field(static=True, default=3)
    color: float = eqx.field(static=True, default=0.1)
    around: int = eqx.field(static=True, default=6)
    own: int = eqx.field(static=True, default=12)
    points: int = eqx.field(static=True, default=4096)
    at_once: int = eqx.field(static=True, default=1)
    # Widths of the matching features in each round of ICP, in gaps between points.
    widths: tuple[float, ...] = eqx.field(static=True, default=(4, 3, 2, 2, 1.5, 1.5, 1, 1))


def registration_for(platform: str) -> RegistrationOptions:
    """Settings with which a device (cpu, gpu) needs about a second for a timestamp."""
    if platform != "cpu":
        return RegistrationOptions(at_once=32)
    return RegistrationOptions(seeds=96, hypotheses=16, best=2, points=1024)


class RigidMotion(NamedTuple):
    """How each point moves until the next timestamp.

    Args:
        displacement: displacement of the point, in scene units.
        quat: rotation of its surroundings about it, a unit quaternion.
        residual: mean distance of its moved surroundings from the points there, in gaps between
            points (3: lost).
    """

    displacement: Float[np.ndarray, "points 3"]
    quat: Float[np.ndarray, "points 4"]
    residual: Float[np.ndarray, " points"]


class _Cloud(NamedTuple):
    """Points of one timestamp, padded."""

    position: Float[Array, "rows 3"]
    color: Float[Array, "rows 3"]


def registered(
    position: Float[np.ndarray, "points 3"],
    color: Float[np.ndarray, "points 3"],
    next_position: Float[np.ndarray, "next 3"],
    next_color: Float[np.ndarray, "next 3"],
    *,
    reach: float,
    options: RegistrationOptions | None = None,
    seed: int = 0,
) -> RigidMotion:
    """Where the points of one timestamp are at the next: nearest neighbours would be wrong by most
    of the way, so patches search from many starts.

    Args:
        position: points at the timestamp, in the world.
        color: their sRGB-encoded colours, in 0..1.
        next_position: points at the other timestamp.
        next_color: their sRGB-encoded colours.
        reach: the longest displacement that is tried, in the unit of the positions.
        options: how thoroughly to search; None is the default.
        seed: of the drawn patches.
    """
    options = options or RegistrationOptions()
    count, dice = len(position), np.random.default_rng(seed)
    if min(count, len(next_position)) < 8:
        still = np.tile(np.asarray([1, 0, 0, 0], position.dtype), (count, 1))
        return RigidMotion(np.zeros_like(position), still, np.full(count, _LOST, position.dtype))
    gap = typical_gap(next_position)
    center = next_position.mean(axis=0)
    used = dice.permutation(count)[: options.points]
    here = _padded((position[used] - center) / gap, color[used], options)
    chosen = dice.permutation(len(next_position))[: options.points]
    there = _padded((next_position[chosen] - center) / gap, next_color[chosen], options)
    seeds = dice.integers(len(used), size=options.seeds)
    uniform = dice.random((options.seeds, options.points)).astype(position.dtype)
    moved = _registered(
        here,
        there,
        jnp.asarray(seeds),
        jnp.asarray(uniform),
        jnp.asarray(reach / gap, position.dtype),
        options,
    )
    shift, turn, quat, residual = (np.asarray(x)[: len(used)] for x in moved)
    nearest = KDTree(position[used]).query(position)[1]
    way = position - position[used][nearest]
    turned = np.einsum("nij,nj->ni", turn[nearest], way) - way
    return RigidMotion(shift[nearest] * gap + turned, quat[nearest], residual[nearest])


def typical_gap(position: Float[np.ndarray, "points 3"]) -> float:
    """Median distance of a point to its nearest neighbour, of at most 2,000 points."""
    some = position[:: max(1, len(position) // 2000)]
    distance = KDTree(position).query(some, k=2)[0][:, 1]
    return float(np.median(distance)) or 1e-6 * float(np.ptp(position)) or 1.0


def _padded(position, color, options):
    lack = options.points - len(position)
    far = np.pad(position, ((0, lack), (0, 0)), constant_values=_NOWHERE)
    return _Cloud(jnp.asarray(far), jnp.asarray(np.pad(color, ((0, lack), (0, 0)))))


@eqx.filter_jit
def _registered(
    here: _Cloud,
    there: _Cloud,
    seeds: Int[Array, " seeds"],
    uniform: Float[Array, "seeds rows"],
    reach: Float[Array, ""],
    options: RegistrationOptions,
) -> tuple[
    Float[Array, "rows 3"], Float[Array, "rows 3 3"], Float[Array, "rows 4"], Float[Array, " rows"]
]:
    """Displacement, rotation (matrix and quaternion) and residual of every point, in gaps."""

    def patch_motion(parts):
        seed, jitter = parts
        return _patch_motion(here, there, seed, jitter, reach, options)

    quat, shift, pivot, score = jax.lax.map(
        patch_motion, (seeds, uniform), batch_size=options.at_once
    )

    def point_motion(position):
        return _point_motion(here, there, position, quat, shift, pivot, score, options)

    at_once = max(64, 8 * options.at_once)
    way, turn, residual = jax.lax.map(point_motion, here.position, batch_size=at_once)
    return way, rotation_matrix(turn), turn, residual


def _features(position, color, width, options):
    return jnp.concatenate([position / width, color / options.color], axis=-1)


def _nearest(a: Float[Array, "n d"], b: Float[Array, "m d"]):
    """Distance to and row of the nearest of `b` for each of `a`."""
    square = jnp.sum(a * a, axis=1)[:, None] + jnp.sum(b * b, axis=1)[None]
    square = square - 2 * product("nd,md->nm", a, b)
    best = jnp.argmin(square, axis=1)
    away = a - b[best]
    return jnp.sqrt(jnp.sum(away * away, axis=1)), best


def _patch_motion(here, there, seed, jitter, reach, options):
    """Rotation, displacement, pivot and score of one patch's best motion."""
    pivot, shade = here.position[seed], here.color[seed]
    away = jnp.sum((here.position - pivot[None]) ** 2, axis=1)
    rows = jax.lax.top_k(-away, options.patch)[1]
    patch, color = here.position[rows] - pivot[None], here.color[rows]
    way = there.position - pivot[None]
    far = jnp.sqrt(jnp.sum(way * way, axis=1)) > reach
    like = jnp.sqrt(jnp.sum((there.color - shade[None]) ** 2, axis=1))
    unlike = like + 0.5 * options.color * jitter + 100 * far
    ways = way[jax.lax.top_k(-unlike, options.hypotheses)[1]]
    # Standing still is a hypothesis as well.
    ways = ways.at[0].set(0)
    some = slice(None, None, 3)
    tried = (patch[some][None] + ways[:, None] + pivot[None, None]).reshape(-1, 3)
    shades = jnp.tile(color[some], (options.hypotheses, 1))
    wide = options.widths[0]
    distance, _ = _nearest(
        _features(tried, shades, wide, options),
        _features(there.position, there.color, wide, options),
    )
    score = jnp.minimum(distance, _LOST).reshape(options.hypotheses, -1).mean(axis=1)
    starts = ways[jax.lax.top_k(-score, options.best)[1]]
    quat, shift, score = jax.vmap(
        lambda start: _refined(patch, color, pivot, there, start, options)
    )(starts)
    best = jnp.argmin(score)
    return quat[best], shift[best], pivot, score[best]


def _refined(patch, color, pivot, there, start, options):
    """Rigid ICP of one patch from one start: every round matches in places and colours, then fits
    rotation and displacement to the matches, weighted by their likeness."""

    def residual(quat, shift, width):
        turned = product("ij,nj->ni", rotation_matrix(quat), patch)
        now = turned + (pivot + shift)[None]
        return _nearest(
            _features(now, color, width, options),
            _features(there.position, there.color, width, options),
        )

    def step(motion, width):
        distance, match = residual(motion[0], motion[1], width)
        weight = jnp.exp(-0.5 * distance**2) + 1e-6
        return rigid(patch, there.position[match] - pivot[None], weight), None

    still = jnp.asarray([1, 0, 0, 0], patch.dtype)
    widths = jnp.asarray(options.widths, patch.dtype)
    (quat, shift), _ = jax.lax.scan(step, (still, start), widths)
    distance, _ = residual(quat, shift, widths[-1])
    return quat, shift, jnp.minimum(distance, _LOST).mean()


def rigid(
    source: Float[Array, "n 3"], target: Float[Array, "n 3"], weight: Float[Array, " n"]
) -> tuple[Float[Array, "4"], Float[Array, "3"]]:
    """Rotation (quaternion) about the origin and displacement that best take points to others.

    Weighted least squares (`best_rotation`).

    Args:
        source: the points before they move.
        target: where each of them shall be, in the same frame.
        weight: weight of each pair, of any positive sum.
    """
    weight = weight / jnp.sum(weight)
    middle, goal = (jnp.sum(weight[:, None] * x, axis=0) for x in (source, target))
    s = product("ni,nj->ij", weight[:, None] * (source - middle[None]), target - goal[None])
    quat = best_rotation(s)
    return quat, goal - product("ij,j->i", rotation_matrix(quat), middle)


def best_rotation(spread: Float[Array, "*n 3 3"]) -> Float[Array, "*n 4"]:
    """The rotation that best takes vectors a to vectors b, of their moments sum(a b^T).

    The quaternion is the eigenvector of the largest eigenvalue of Horn's matrix (1987), found by
    squaring it. Without vectors it is the identity.

    Args:
        spread: the moments, a first.
    """
    s = spread
    trace = s[..., 0, 0] + s[..., 1, 1] + s[..., 2, 2]
    side = jnp.stack(
        [
            s[..., 1, 2] - s[..., 2, 1],
            s[..., 2, 0] - s[..., 0, 2],
            s[..., 0, 1] - s[..., 1, 0],
        ],
        axis=-1,
    )
    identity = jnp.broadcast_to(jnp.eye(3, dtype=s.dtype), s.shape)
    body = s + jnp.swapaxes(s, -1, -2) - trace[..., None, None] * identity
    top = jnp.concatenate([trace[..., None], side], axis=-1)[..., None, :]
    horn = jnp.concatenate([top, jnp.concatenate([side[..., None], body], axis=-1)], axis=-2)
    # All eigenvalues are at most the Frobenius norm in size: shifted by it, none is negative.
    norm = jnp.sqrt(jnp.sum(horn**2, axis=(-2, -1), keepdims=True)) + 1e-30
    power = horn / norm + jnp.broadcast_to(jnp.eye(4, dtype=s.dtype), horn.shape)
    for _ in range(12):
        power = product("...ij,...jk->...ik", power, power)
        power = power / jnp.max(jnp.abs(power), axis=(-2, -1), keepdims=True)
    longest = jnp.argmax(jnp.sum(power**2, axis=-2), axis=-1)
    column = jnp.take_along_axis(power, longest[..., None, None], axis=-1)[..., 0]
    return normalize_quaternion(column)


def _point_motion(here, there, position, quat, shift, pivot, score, options):
    """The motion, of those of the nearest patches, that suits one point's own surroundings best."""
    away = jnp.sum((pivot - position[None]) ** 2, axis=1)
    chosen = jax.lax.top_k(-away, options.around)[1]
    around = jnp.sum((here.position - position[None]) ** 2, axis=1)
    rows = jax.lax.top_k(-around, options.own)[1]
    near, color = here.position[rows], here.color[rows]

    def moved(index, place):
        turned = product("ij,nj->ni", rotation_matrix(quat[index]), place - pivot[index][None])
        return turned + (pivot[index] + shift[index])[None]

    width = options.widths[-1]
    target = _features(there.position, there.color, width, options)
    placed = jax.vmap(lambda index: moved(index, near))(chosen).reshape(-1, 3)
    shades = jnp.tile(color, (options.around, 1))
    distance, _ = _nearest(_features(placed, shades, width, options), target)
    own = jnp.minimum(distance, _LOST).reshape(options.around, -1).mean(axis=1)
    best = chosen[jnp.argmin(own + 0.5 * score[chosen])]
    place = moved(best, position[None])[0]
    return place - position, quat[best], jnp.min(own)
