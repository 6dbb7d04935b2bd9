"""Points where stereo finds none: in every pixel's colour, where other views show that colour too.

Cameras that stand far apart see the same surface from sides too different for windows to match.
Colours averaged over large pixels still agree. Each such pixel gets a point on its ray, at the
distance where the others that see the point differ least from it: what nearly matches is a better
start than random points, which hide everything behind them.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from gaussray.capture.points import Points
from gaussray.color import srgb_decode
from gaussray.reconstruct.data.backdrop import is_black, like_backdrop
from gaussray.reconstruct.initialize.stereo.from_pictures import StereoViewSet, some_views
from gaussray.reconstruct.initialize.stereo.neighbours import typical_spread
from gaussray.reconstruct.initialize.stereo.uncovered import VIEWS, backdrop
from gaussray.reconstruct.initialize.stereo.views import (
    StereoViews,
    rays,
    sampled,
    seen_at,
    stereo_views,
    unpacked,
)


# Distances that are looked at, in median distances between two cameras, and how many.
_NEAREST, _FARTHEST, _DEPTHS = 0.1, 20.0, 64
# Views that a pixel is compared with, at most.
_OTHERS = 12
# A difference of colour (of 1) that counts no more if it is larger, and that of a view which does
# not see the point.
_LARGEST, _UNSEEN = 0.15, 0.075
# Cost of a distance for each factor e by which it differs from that between cameras: it decides
# where colours do not.
_UNUSUAL = 0.002
# Pixels around one that vote for its distance.
_WINDOW = 3


def guessed_points(seen: StereoViewSet, *, count: int, seed: int) -> Points:
    """About `count` points at the distances where colours agree best, none on a black backdrop.

    Args:
        seen: pictures that show what stands still.
        count: about how many pixels all reduced pictures have together.
        seed: of what distances differ by from the steps that are looked at.
    """
    seen = some_views(seen, VIEWS)
    h, w = seen.pictures.shape[1:3]
    factor = int(np.ceil(np.sqrt(len(seen.frames) * h * w / max(count, 1))))
    factor = int(np.clip(factor, 1, min(h, w) // (2 * _WINDOW) or 1))
    views = stereo_views(seen.pictures, seen.cameras, seen.masks, factor=factor)
    plain, spread = backdrop(views), typical_spread(views)
    depth = spread * np.geomspace(_NEAREST, _FARTHEST, _DEPTHS)
    step, dice = np.log(depth[1] / depth[0]), np.random.default_rng([seed, 5])
    places, colors = [], []
    for i in range(len(seen.frames)):
        others = np.delete(np.arange(len(seen.frames)), i)
        others = others[np.linspace(0, len(others) - 1, min(len(others), _OTHERS)).astype(int)]
        best, ray, color, counts = jax.device_get(
            _agreeing(views, jnp.asarray(i), jnp.asarray(others), jnp.asarray(depth), spread)
        )
        shown = counts & np.any(ray != 0, axis=0)
        away = depth[best] * np.exp(step * dice.uniform(-0.5, 0.5, best.shape))
        if plain is not None:
            behind = like_backdrop(np.moveaxis(color, 0, -1), plain)
            away = np.where(behind, depth[-1], away)
            shown &= ~(behind & is_black(plain))
        places.append((np.asarray(views.origin[i])[:, None] + ray[:, shown] * away[shown]).T)
        colors.append(color[:, shown].T)
    color = np.concatenate([np.zeros((0, 3)), *colors]).astype(np.float64)
    place = np.concatenate([np.zeros((0, 3)), *places])
    return Points(place.astype(np.float32), srgb_decode(color).astype(np.float32))


@eqx.filter_jit
def _agreeing(
    views: StereoViews,
    i: Int[Array, ""],
    others: Int[Array, " others"],
    depth: Float[Array, " depths"],
    spread: float,
) -> tuple[Array, ...]:
    """The index of the distance at which the others agree best with each pixel of a view, the
    pixels' rays and colours, and whether they count."""
    own = views[i]
    ray = rays(own.lens, own.world_from_camera, own.size, own.factor)
    channels, counts = unpacked(own.pixel, ray.dtype)
    color, depth = jnp.stack(channels), depth.astype(ray.dtype)
    place = own.origin[:, None, None, None] + ray[:, None] * depth[None, :, None, None]
    around = views[others]
    column, row, sees = seen_at(around, place)
    found, unmasked = sampled(around.pixel, column, row)
    difference = sum(abs(a - b[None, None]) for a, b in zip(found, color, strict=True)) / 3
    sees = sees & unmasked
    told = jnp.sum(jnp.where(sees, jnp.minimum(difference, _LARGEST), 0), axis=0)
    cost = (told + _UNSEEN) / (jnp.sum(sees, axis=0) + 1)
    beside, window = _WINDOW // 2, (1, _WINDOW, _WINDOW)
    cost = jnp.pad(cost, ((0, 0), (beside, beside), (beside, beside)), mode="edge")
    total = jax.lax.reduce_window(cost, 0.0, jax.lax.add, window, (1, 1, 1), "VALID")
    unusual = _UNUSUAL * jnp.abs(jnp.log(depth / spread))
    best = jnp.argmin(total / _WINDOW**2 + unusual[:, None, None], axis=0)
    return best, ray, color, counts
