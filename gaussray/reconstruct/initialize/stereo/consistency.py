"""The cross-view check: which surfaces other views see where one view sees them."""

import functools
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from gaussray.reconstruct.initialize.stereo.views import (
    StereoViews,
    corners,
    distance_from,
    seen_at,
)


# The relative difference of two distances that are the same: a pixel of the other view, between
# these.
_LEAST, _MOST = 0.005, 0.03


class Agreement(NamedTuple):
    """What other views say of every pixel's point.

    Args:
        confirmed: number of views that confirm it.
        crossed: number of views that see through it.
        inverse: inverse distance, averaged over the view and those that confirm it.
    """

    confirmed: Int[Array, "h w"]
    crossed: Int[Array, "h w"]
    inverse: Float[Array, "h w"]


def agreement(
    own: StereoViews,
    ray: Float[Array, "3 h w"],
    inverse: Float[Array, "h w"],
    near: StereoViews,
    maps: Float[Array, "near h w"],
    step: Float[Array, ""],
) -> Agreement:
    """What the distance maps of other views say of a view's points.

    A view confirms a point if one of the four pixels around its place holds a distance that differs
    by less than what moves the point by one pixel in the neighbours, 0.5 to 3 % of the distance. It
    sees through the point if all four lie further behind it than twice that.

    Args:
        own: the view that is checked.
        ray: unit viewing directions of its pixels in the world.
        inverse: inverse distance of its surface along each ray; 0 where nothing is known.
        near: the views that it is compared with.
        maps: their inverse distances; 0 where nothing is known.
        step: inverse distance by which a point moves by one pixel in the neighbours.
    """
    known = inverse > 0
    distance = 1 / jnp.where(known, inverse, 1)
    tolerance = jnp.clip(step * distance, _LEAST, _MOST)
    point = own.origin[:, None, None] + ray * distance[None]

    x, y, inside = seen_at(near, point)
    away = distance_from(near, point)
    around, _, _ = corners(maps, x, y)
    # Distance there over distance of the point, minus 1; -1 where nothing is known.
    ratios = [jnp.where(a > 0, 1 / (jnp.maximum(a, 1e-12) * away) - 1, -1) for a in around]
    error = functools.reduce(lambda a, b: jnp.where(jnp.abs(b) < jnp.abs(a), b, a), ratios)
    valid = inside & known[None]
    same = valid & (jnp.abs(error) < tolerance[None])
    through = valid & (functools.reduce(jnp.minimum, ratios) > 2 * tolerance[None])
    count = jnp.sum(same, axis=0)
    mean = jnp.sum(jnp.where(same, error, 0), axis=0) / (count + 1)
    return Agreement(count, jnp.sum(through, axis=0), inverse / (1 + mean))
