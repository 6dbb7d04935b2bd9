"""The matching cost: how unlike two patches are, and how neighbours agree on it."""

import functools
from collections.abc import Iterable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from gaussray.reconstruct.initialize.stereo.options import StereoOptions
from gaussray.reconstruct.initialize.stereo.views import Channels


class PlaneWindow(NamedTuple):
    """Means over a window of one picture: of each channel and of the squares' sum."""

    color: Channels
    square: Float[Array, "..."]


class Comparison(NamedTuple):
    """Means over a window of another picture: the same two, and those of the colours' products and
    absolute differences with the first picture's, summed over the channels."""

    color: Channels
    square: Float[Array, "..."]
    product: Float[Array, "..."]
    difference: Float[Array, "..."]


def window(color: Channels) -> PlaneWindow:
    """What one pixel adds to a window's means."""
    return PlaneWindow(color, total(c * c for c in color))


def comparison(reference: Channels, color: Channels) -> Comparison:
    """What one pair of pixels adds to a comparison's means.

    Args:
        reference: sRGB-encoded channels of the first picture.
        color: those of the other picture at the place of the same point.
    """
    pairs = list(zip(reference, color, strict=True))
    return Comparison(
        color,
        total(c * c for c in color),
        total(r * c for r, c in pairs),
        total(jnp.abs(r - c) for r, c in pairs),
    )


def total(parts: Iterable[Array]) -> Array:
    """Sum of arrays, element by element."""
    return functools.reduce(jnp.add, parts)


def patch_cost(
    reference: PlaneWindow, other: Comparison, options: StereoOptions
) -> Float[Array, "..."]:
    """Cost in [0, 1] of two windows: zncc (1 - ZNCC) + (1 - zncc) min(difference / color, 1).

    ZNCC is over all channels jointly; the noise variance e keeps it defined without texture:
    (cov + e/2) / sqrt((var + e)(var' + e)), so that two even windows have 1/2. The difference is
    the mean over the channels.

    Args:
        reference: means over the window of the first picture.
        other: means over the window of the other one, and those of both together.
        options: `zncc`, `color` and `noise`.
    """
    channels = len(reference.color)
    noise = channels * options.noise**2
    var = reference.square - total(c * c for c in reference.color)
    var_other = other.square - total(c * c for c in other.color)
    products = (a * b for a, b in zip(reference.color, other.color, strict=True))
    covariance = other.product - total(products)
    scale = (jnp.maximum(var, 0) + noise) * (jnp.maximum(var_other, 0) + noise)
    zncc = (covariance + noise / 2) / jnp.sqrt(scale)
    color = jnp.minimum(other.difference / (channels * options.color), 1)
    return jnp.clip(options.zncc * (1 - zncc) + (1 - options.zncc) * color, 0, 1)


def best_half(
    cost: Float[Array, "views ..."], sees: Bool[Array, "views ..."]
) -> Float[Array, "..."]:
    """Mean cost over the better half (at least two) of the views that see a point: the others may
    see something in front of it.

    1 where no view sees it. Where one of several does, the mean of its cost and 1.

    Args:
        cost: matching cost in each view.
        sees: which views see the point.
    """
    count = cost.shape[0]
    # Else a CPU computes the costs anew for every comparison.
    cost = jax.lax.optimization_barrier(jnp.where(sees, cost, 1))
    taken = jnp.sum(sees, axis=0)
    taken = jnp.maximum((taken + 1) // 2, min(2, count))
    # The rank of each by comparisons: XLA's sort is slow for few elements.
    whole = jnp.zeros_like(cost[0])
    for i in range(count):
        before = [(cost[j] <= cost[i]).astype(jnp.int32) for j in range(i)]
        after = [(cost[j] < cost[i]).astype(jnp.int32) for j in range(i + 1, count)]
        rank = total([*before, *after, jnp.zeros_like(taken)])
        whole += jnp.where(rank < taken, cost[i], 0)
    return whole / taken


def misses(
    cost: Float[Array, "..."],
    sees: Bool[Array, "views ..."],
    hit: Bool[Array, "views ..."],
    weight: float,
) -> Float[Array, "..."]:
    """The cost, plus `weight` for each view beyond the first in which the point is outside of the
    silhouette of what moves.

    Args:
        cost: matching cost over all views.
        sees: in which views the point lies within the picture.
        hit: in which views its place belongs to the silhouette.
        weight: added cost of a view.
    """
    missing = jnp.sum(sees & ~hit, axis=0)
    return cost + weight * jnp.maximum(missing - 1, 0)
