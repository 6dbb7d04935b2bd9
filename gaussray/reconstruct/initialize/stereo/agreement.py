"""How far away a pixel is where nothing matches: as far as other views show its colour, too.

Cameras that stand far apart see the same surface from sides too different for windows to match, and
plain or blurred surfaces have nothing to match. Colours averaged over large pixels still agree: a
pixel is where the others that see the place differ least from it.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from gaussray.reconstruct.initialize.stereo.neighbours import typical_spread
from gaussray.reconstruct.initialize.stereo.views import (
    StereoViews,
    rays,
    sampled,
    seen_at,
    unpacked,
)
from gaussray.runtime.stored_programs import kept_jit


# Distances that are looked at, in median distances between two cameras, and how many.
_NEAREST, _FARTHEST, _DEPTHS = 0.1, 20.0, 64
# Views that a pixel is compared with, evenly spread among the nearest cameras, and how many of
# these there are.
_OTHERS, _AMONG = 12, 20
# A difference of colour (of 1) that counts no more if it is larger, and that of a view which does
# not see the place.
_LARGEST, _UNSEEN = 0.15, 0.075
# Cost of a distance for each factor e by which it differs from the usual one: it decides where
# colours do not.
_UNUSUAL = 0.002
# Pixels around one that vote for its distance.
WINDOW = 3


def agreeing_distance(
    views: StereoViews, i: int, usual: Float[np.ndarray, "*h_w"], dice: np.random.Generator
) -> Float[np.ndarray, "h w"]:
    """The distance of each pixel of a view at which other views agree best with its colour.

    Args:
        views: the views, reduced to large pixels.
        i: the view.
        usual: the distance to take where colours do not tell, of each pixel or of all.
        dice: the source of what distances differ by from the steps that are looked at.
    """
    depth = typical_spread(views) * np.geomspace(_NEAREST, _FARTHEST, _DEPTHS)
    origin = np.asarray(views.origin)
    nearest = np.argsort(np.linalg.norm(origin - origin[i], axis=1), kind="stable")
    among = nearest[nearest != i][:_AMONG]
    others = among[np.linspace(0, len(among) - 1, min(len(among), _OTHERS)).round().astype(int)]
    if not len(others):
        return np.broadcast_to(usual, views.size).copy()
    near = jnp.asarray(np.broadcast_to(usual, views.size))
    best = _agreeing(views, jnp.asarray(i), jnp.asarray(others), jnp.asarray(depth), near)
    half = np.log(depth[1] / depth[0]) / 2
    return depth[np.asarray(best)] * np.exp(dice.uniform(-half, half, views.size))


@kept_jit
def _agreeing(
    views: StereoViews,
    i: Int[Array, ""],
    others: Int[Array, " others"],
    depth: Float[Array, " depths"],
    usual: Float[Array, "h w"],
) -> Int[Array, "h w"]:
    """The index of the distance at which the others agree best with each pixel of a view."""
    own = views[i]
    ray = rays(own.lens, own.world_from_camera, own.size, own.factor)
    channels, _ = unpacked(own.pixel, ray.dtype)
    color, depth = jnp.stack(channels), depth.astype(ray.dtype)[:, None, None]
    place = own.origin[:, None, None, None] + ray[:, None] * depth[None]
    around = views[others]
    column, row, sees = seen_at(around, place)
    found, unmasked = sampled(around.pixel, column, row)
    difference = sum(abs(a - b[None, None]) for a, b in zip(found, color, strict=True)) / 3
    sees = sees & unmasked
    told = jnp.sum(jnp.where(sees, jnp.minimum(difference, _LARGEST), 0), axis=0)
    cost = (told + _UNSEEN) / (jnp.sum(sees, axis=0) + 1)
    beside, window = WINDOW // 2, (1, WINDOW, WINDOW)
    cost = jnp.pad(cost, ((0, 0), (beside, beside), (beside, beside)), mode="edge")
    total = jax.lax.reduce_window(cost, 0.0, jax.lax.add, window, (1, 1, 1), "VALID")
    unusual = _UNUSUAL * jnp.abs(jnp.log(depth) - jnp.log(usual.astype(ray.dtype))[None])
    return jnp.argmin(total / WINDOW**2 + unusual, axis=0)
