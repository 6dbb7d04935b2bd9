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


# The relative difference of two distances that are the same: one step of the sweep, within this.
_LEAST, _MOST = 0.005, 0.03


class Agreement(NamedTuple):
    """How many views confirm a pixel's point, how many see through it, and its inverse distance
    averaged over those that confirm it."""

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
    """What the distance maps of other views (`maps`: inverse distances, 0 where nothing is known)
    say of a view's points.

    A view confirms a point if one of the four pixels around its place holds a distance that differs
    by less than what a step of the sweep is at the point, 0.5 to 3 % of it. It sees through the
    point if all four lie further behind it than twice that.
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
