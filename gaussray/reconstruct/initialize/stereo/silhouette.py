"""Points inside the silhouettes of what moves, where pictures are too unlike to match: few cameras,
far apart.

A pixel that moves in one picture shows something that must lie within the moving pixels of all
other pictures that see the place (the visual hull, Laurentini 1994). Of the distances along its
ray at which it does, and which most pictures see, the one is taken at which the colours of the
pictures differ least.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from gaussray.reconstruct.initialize.stereo.neighbours import typical_spread
from gaussray.reconstruct.initialize.stereo.points import StereoPoints, no_points
from gaussray.reconstruct.initialize.stereo.views import (
    StereoViews,
    corners,
    rays,
    sampled,
    seen_at,
    unpacked,
)
from gaussray.runtime.stored_programs import kept_jit


# Pixels of a view whose rays are looked along, and distances on each; these lie between so many
# times the spread of the cameras.
_PIXELS, _DISTANCES, _NEAREST, _FARTHEST = 1024, 256, 0.05, 20.0
# Of so many views one may miss a point: what moves can look like what is behind it.
_VIEWS_A_MISS = 6
# Differences of colour (of 1) that are noise: of distances that are as good, the nearest is taken.
_AS_GOOD = 0.02
# Of the choice of pixels.
_SEED = 0


def silhouette_points(views: StereoViews, moved: Bool[np.ndarray, "views h w"]) -> StereoPoints:
    """Points of pixels that move, inside the silhouettes of all views.

    Args:
        views: pictures of one instant; their masks hold what moves, with a margin.
        moved: which of their pixels move.

    Returns:
        Points; none of pixels for which no distance lies in another view's silhouette.
    """
    distance = typical_spread(views) * np.geomspace(_NEAREST, _FARTHEST, _DISTANCES)
    parts = []
    for i, mask in enumerate(moved):
        place = np.flatnonzero(mask)
        if not len(place):
            continue
        dice = np.random.default_rng([_SEED, i, 3])
        # As many rows for every view, so that one program does for all.
        chosen = np.resize(dice.permutation(place), _PIXELS)
        at, found, color = jax.device_get(
            _along_rays(
                views,
                jnp.asarray(i),
                jnp.asarray(chosen),
                jnp.asarray(distance, views.origin.dtype),
            )
        )
        own = np.arange(_PIXELS) < len(place)
        keep = found & own
        number = int(keep.sum())
        gap = np.sqrt(len(place) / min(len(place), _PIXELS)) * float(views.angle[i])
        away = np.linalg.norm(at[keep] - np.asarray(views.origin[i]), axis=1)
        toward = (np.asarray(views.origin[i]) - at[keep]) / np.maximum(away, 1e-12)[:, None]
        parts.append(
            StereoPoints(at[keep], toward, color[keep], np.full(number, 0.1), away, gap * away)
        )
    if not parts:
        return no_points()
    whole = (np.concatenate(x).astype(np.float32) for x in zip(*parts, strict=True))
    return StereoPoints(*whole)


@kept_jit
def _along_rays(
    views: StereoViews,
    i: Int[Array, ""],
    chosen: Int[Array, " pixels"],
    distance: Float[Array, " distances"],
) -> tuple[Float[Array, "pixels 3"], Bool[Array, " pixels"], Float[Array, "pixels 3"]]:
    """The best place along the ray of each chosen pixel of a view, whether there is any inside the
    silhouettes, and the pixel's colour."""
    own = views[i]
    ray = rays(own.lens, own.world_from_camera, own.size, own.factor).reshape(3, -1)[:, chosen]
    channels, _ = unpacked(own.pixel.reshape(-1)[chosen], ray.dtype)
    point = own.origin[:, None, None] + ray[:, :, None] * distance[None, None]
    x, y, inside = seen_at(views, point)
    others = inside & (jnp.arange(len(views.origin)) != i)[:, None, None]
    colors, _ = sampled(views.pixel, x, y)
    # Of the four pixels around a place one is enough: silhouettes are frayed.
    (a, b, c, d), _, _ = corners(views.pixel, x, y)
    _, masked = unpacked(a | b | c | d, ray.dtype)
    difference = sum(jnp.abs(s - o[None, :, None]) for s, o in zip(colors, channels, strict=True))
    seen = jnp.sum(others, axis=0)
    allowed = (seen > 0) & (jnp.sum(others & ~masked, axis=0) <= seen // _VIEWS_A_MISS)
    # Right before a camera hardly any other one sees the ray: most views decide.
    allowed &= seen == jnp.max(jnp.where(allowed, seen, 0), axis=1, keepdims=True)
    cost = jnp.sum(jnp.where(others, difference, 0), axis=0) / (3 * jnp.maximum(seen, 1))
    cost = jnp.where(allowed, cost, jnp.inf)
    best = jnp.argmax(cost <= jnp.min(cost, axis=1, keepdims=True) + _AS_GOOD, axis=1)
    at = jnp.take_along_axis(point, best[None, :, None], axis=2)[:, :, 0]
    formed = jnp.any(ray != 0, axis=0)
    return at.T, jnp.any(allowed, axis=1) & formed, jnp.stack(channels, axis=1)
