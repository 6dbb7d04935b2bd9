"""Which views are compared with each, and between which distances."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from gaussray.reconstruct.initialize.stereo.views import StereoViews, rays, seen_at
from gaussray.runtime.stored_programs import kept_jit


# Rays along each side of a picture, and distances, at which views are compared; the distances lie
# between these multiples of the cameras' spread.
_GRID, _STEPS, _NEAREST, _FARTHEST = 5, 40, 0.03, 100.0
# Radians between the rays to a point: below the first a pair says little of its distance, and
# beyond the second patches no longer look alike.
_NARROW, _WIDE = np.radians(8.0), np.radians(60.0)
# A patch may be so many times as far from one view as from the other.
_LARGER = 2.5
# A distance is looked at where this share of a view's rays meets two neighbours, and up to where
# the disparity from infinity is this many pixels.
_SHARE, _DISPARITY = 0.1, 2.0


class StereoPairs(eqx.Module):
    """What every view is compared with.

    Args:
        neighbour: indices of its neighbours, the best first.
        nearest: inverse of the shortest distance at which its surfaces are looked for.
        farthest: inverse of the longest one.
        step: inverse distance by which a point of the view moves by one pixel in the neighbours.
    """

    neighbour: Int[np.ndarray, "views neighbours"]
    nearest: Float[np.ndarray, " views"]
    farthest: Float[np.ndarray, " views"]
    step: Float[np.ndarray, " views"]


def stereo_pairs(
    views: StereoViews, count: int, known: Float[np.ndarray, "points 3"] | None = None
) -> StereoPairs:
    """The best neighbours of every view, and the distances at which two of them see its surfaces.

    A neighbour is the better, the more of the view's rays it sees at useful angles, over all
    distances.

    Args:
        views: all views.
        count: largest number of neighbours.
        known: points of the scene; None if there are none. If a view sees 20 of them or more, only
            distances from 2/3 of the first to twice the last percentile of theirs are looked at.
    """
    origin = np.asarray(views.origin, np.float64)
    spread = typical_spread(views)
    distance = spread * np.geomspace(_NEAREST, _FARTHEST, _STEPS)
    count = min(count, len(origin) - 1)
    rows = [
        _one(views, i, distance, count, spread, None if known is None else jnp.asarray(known))
        for i in range(len(origin))
    ]
    neighbour, nearest, farthest, step = (np.array(x) for x in zip(*rows, strict=True))
    return StereoPairs(neighbour, nearest, farthest, step)


def typical_spread(views: StereoViews) -> float:
    """Median distance between two cameras; 1 for a single one."""
    origin = np.asarray(views.origin, np.float64)
    if len(origin) < 2:
        return 1.0
    some = origin[:: max(1, len(origin) // 200)]
    away = np.linalg.norm(some[:, None] - some[None], axis=-1)[np.triu_indices(len(some), 1)]
    return float(np.median(away)) or float(away.max()) or 1.0


def _one(views, i, distance, count, spread, known):
    """The row of one view."""
    ray, sees, angle, ratio = (
        np.asarray(x)
        for x in _overlap(views, jnp.asarray(i), jnp.asarray(distance, views.origin.dtype))
    )
    quality = np.where(
        angle < _NARROW, angle / _NARROW, np.maximum(1 - (angle - _NARROW) / (_WIDE - _NARROW), 0)
    )
    sees = sees & (ratio < _LARGER) & (ratio > 1 / _LARGER)
    score = (sees * quality).sum(axis=(1, 2))
    score[i] = -1
    best = np.argsort(-score, kind="stable")[:count]
    useful = sees[best] & (angle[best] < _WIDE)
    share = (useful.sum(axis=0) >= min(2, count)).mean(axis=0)
    reached = np.flatnonzero(share >= _SHARE * max(share.max(), 1e-9))
    near = distance[reached[0]] if share.max() > 0 else spread
    # By an inverse distance d, the ray to a point turns by d times the part of the baseline that is
    # perpendicular to it.
    baseline = np.asarray(views.origin)[best] - np.asarray(views.origin)[i]
    across = np.linalg.norm(np.cross(ray.T[None], baseline[:, None]), axis=-1)
    step = float(views.angle[i]) / max(float(np.median(across)), 1e-6 * spread)
    nearest, farthest = 1 / near, min(_DISPARITY * step, 0.5 / near)
    if known is not None and len(known):
        nearest, farthest = _narrowed(views, i, known, nearest, farthest)
    return best, nearest, farthest, step


@kept_jit
def _overlap(views: StereoViews, i: Int[Array, ""], distance: Float[Array, " steps"]):
    """Whether each view sees the points at these distances on a grid of one view's rays, and the
    angle between the two rays there and the ratio of the two distances: [views, rays, steps] each,
    after the rays."""
    own = views[i]
    ray = rays(own.lens, own.world_from_camera, own.size, own.factor)
    h, w = own.size
    at = [jnp.asarray(((np.arange(_GRID) + 0.5) * n / _GRID).astype(int)) for n in (h, w)]
    ray = ray[:, at[0][:, None], at[1][None]].reshape(3, -1)
    point = own.origin[:, None, None] + ray[:, :, None] * distance[None, None]

    formed = jnp.any(ray != 0, axis=0)[:, None]

    def by(view: StereoViews):
        _, _, inside = seen_at(jax.tree.map(lambda x: x[None], view), point)
        back = point - view.origin[:, None, None]
        away = jnp.sqrt(jnp.sum(back * back, axis=0))
        cosine = jnp.sum(ray[:, :, None] * back, axis=0) / jnp.maximum(away, 1e-12)
        angle = jnp.arccos(jnp.clip(cosine, -1, 1))
        return inside[0] & formed, angle, away / distance[None]

    return ray, *jax.lax.map(by, views)


def _narrowed(views, i, known, nearest, farthest):
    """The inverse distances that the known points leave."""
    away, inside = (np.asarray(x) for x in _seen_known(views, jnp.asarray(i), known))
    away = away[inside]
    if len(away) < 20:
        return nearest, farthest
    low, high = np.quantile(away, (0.01, 0.99))
    return min(nearest, 1.5 / low), max(farthest, 0.5 / high)


@kept_jit
def _seen_known(views: StereoViews, i: Int[Array, ""], known: Float[Array, "known 3"]):
    """How far known points are from a view, and which of them it sees."""
    point = known.T.astype(views.origin.dtype)
    _, _, (inside,) = seen_at(views[i[None]], point)
    return jnp.sqrt(jnp.sum((point - views.origin[i][:, None]) ** 2, axis=0)), inside
