"""Transient Gaussians within a time span: which are alive, and how far they move."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from gaussray.scene.gaussians import Gaussians, concatenate
from gaussray.scene.transient import Transients, squared_age
from gaussray.tracer.motion import Motion, is_valid, merge_rest, still
from gaussray.tracer.response import reach_radius


# Lifetimes about its instant within which a Gaussian is alive: an opacity of 1 has faded below
# 1 / 255 after 3.3.
_LIFETIMES = 3.4


class TimeWindow(eqx.Module):
    """How Gaussians move and fade in time: velocity, instant, rate (1 / lifetime) and plateau of
    `Transients`, zeros for Gaussians that are there all the time."""

    velocity: Float[Array, "*gaussians 3"]
    instant: Float[Array, "*gaussians"]
    rate: Float[Array, "*gaussians"]
    plateau: Float[Array, "*gaussians"]


class Sweep(eqx.Module):
    """Motion and fading of Gaussians within a time span.

    Args:
        first: displacement from the mean when the Gaussian is first alive, in scene units.
        last: displacement when it is last alive.
        shrink: largest size of its ellipsoid, relative to that at full opacity; 0 if it is not
            alive.
    """

    first: Float[Array, "*gaussians 3"]
    last: Float[Array, "*gaussians 3"]
    shrink: Float[Array, "*gaussians"]


def time_window_of(transients: Transients) -> TimeWindow:
    """The window of every transient Gaussian."""
    t = transients
    return TimeWindow(t.velocity, t.instant, 1 / t.lifetime, t.plateau)


def all_states(motion: Motion) -> tuple[Gaussians, TimeWindow | None]:
    """All Gaussians of a motion at its keys, and their time windows.

    Returns:
        Gaussians without key states, moving ones, then transient ones as at their own instants; and
        the windows, None if no Gaussian is transient.
    """
    persistent, transient = merge_rest(motion).gaussians, motion.transient
    if transient is None:
        return persistent, None
    none = jnp.zeros(persistent.count, persistent.mean.dtype)
    steady = TimeWindow(jnp.zeros((persistent.count, 3), none.dtype), none, none, none)
    window = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), steady, time_window_of(transient))
    return concatenate(persistent, transient.gaussians), window


def swept_between(
    window: TimeWindow,
    radius: Float[Array, "*gaussians"],
    earliest: Float[Array, "*windows"],
    latest: Float[Array, "*windows"],
) -> Sweep:
    """Displacement and shrinking of Gaussians between two times.

    A transient Gaussian is alive while its window leaves it more than alpha_min: s < `radius`, its
    reach in standard deviations at full opacity. Its ellipsoid then reaches to
    sqrt(radius^2 - s^2), at most to that at the time nearest to its instant.

    Args:
        window: the time windows.
        radius: reach at full opacity, in standard deviations.
        earliest: first time, in the capture's unit.
        latest: last time.
    """
    first, last = earliest - window.instant, latest - window.instant
    nearest = jnp.maximum(jnp.maximum(first, -last), 0)
    squared, faded = radius * radius, squared_age(nearest, window.rate, window.plateau)
    alive = (faded < squared) & (first <= last)
    divisor = jnp.where(squared > 0, squared, 1)
    shrink = jnp.where(alive, jnp.sqrt(jnp.maximum(1 - faded / divisor, 0)), 0)
    # Rounding must not cut off what a ray at the very end of the window still meets.
    eps = 8 * jnp.finfo(radius.dtype).eps
    rate = jnp.where(window.rate > 0, window.rate, 1)
    length = jnp.where(window.rate > 0, (window.plateau + radius / rate) * (1 + eps), jnp.inf)
    first, last = (jnp.clip(x, -length, length)[..., None] for x in (first, last))
    shrink = jnp.minimum(shrink * (1 + eps) + jnp.where(alive, eps, 0), 1)
    return Sweep(first * window.velocity, last * window.velocity, shrink)


def swept_box(
    lower: Float[Array, "gaussians 3"], upper: Float[Array, "gaussians 3"], swept: Sweep
) -> tuple[Float[Array, "gaussians 3"], Float[Array, "gaussians 3"]]:
    """Lower and upper corners of the boxes that contain Gaussians during a time span.

    Args:
        lower: lower corners at full opacity at their own instants.
        upper: upper corners.
        swept: their motion during the span.
    """
    center = 0.5 * (lower + upper)
    least, most = jnp.minimum(swept.first, swept.last), jnp.maximum(swept.first, swept.last)
    # With slack for the rounding of the way itself.
    slack = 4 * jnp.finfo(center.dtype).eps * (jnp.abs(center) + jnp.abs(least) + jnp.abs(most))
    half = swept.shrink[:, None] * (upper - center) + slack
    return center - half + least, center + half + most


def most_alive(transients: Transients, times: Float[np.ndarray, " times"]) -> int:
    """The largest number of transient Gaussians that are alive at one of some times; on the host,
    so that nothing is compiled.

    Args:
        transients: the Gaussians.
        times: the times, at least one, in the capture's unit.
    """
    instant, around = np.asarray(transients.instant), np.asarray(transients.plateau)
    around = around + _LIFETIMES * np.asarray(transients.lifetime)
    begun = np.searchsorted(np.sort(instant - around), times, "right")
    return int(np.max(begun - np.searchsorted(np.sort(instant + around), times, "left")))


class AliveTransients(eqx.Module):
    """The transient Gaussians that are alive within a time span.

    Args:
        transients: the Gaussians, in a fixed number of places; an empty place has opacity 0.
        index: their indices among all transient Gaussians; -1 for an empty place.
        needed: number of places that they need.
        unusable: number of Gaussians that are not finite: those whose windows are not, and the
            alive ones with other values that are not.
    """

    transients: Transients
    index: Int[Array, " places"]
    needed: Int[Array, ""]
    unusable: Int[Array, ""]


def rows_under(
    mask: Bool[Array, " rows"], places: int
) -> tuple[Int[Array, " places"], Bool[Array, " places"]]:
    """The numbers of the rows under a mask, in their order, and which places have one; the first
    rows if there are too many.

    (`jnp.nonzero` counts the rows before each place, all at few addresses: a GPU waits for that.)

    Args:
        mask: which rows are chosen.
        places: number of places; those that are left have a number beyond all rows.
    """
    count = mask.shape[0]
    place = jnp.where(mask, jnp.cumsum(mask, dtype=jnp.int32) - 1, places)
    index = jnp.full(places, count, jnp.int32)
    index = index.at[place].set(jnp.arange(count, dtype=jnp.int32), mode="drop")
    return index, index < count


def alive_transients(
    transients: Transients, span: Float[Array, "2"], places: int, alpha_min: float
) -> AliveTransients:
    """Select the transient Gaussians that are alive; the first of them if there are too many.

    Only windows and opacities of all Gaussians are read, so that a trace costs hardly more than
    that of the alive ones. Gradients reach the selected Gaussians.

    Args:
        transients: all transient Gaussians.
        span: first and last time of the rays.
        places: number of places.
        alpha_min: alpha below which a Gaussian has no effect.
    """
    fixed = jax.lax.stop_gradient(transients)
    window = time_window_of(fixed)
    windows = jnp.stack([window.instant, window.rate, window.plateau, fixed.opacity])
    finite = jnp.all(jnp.isfinite(windows), axis=0) & (window.rate >= 0)
    swept = swept_between(window, reach_radius(fixed.opacity, alpha_min), span[0], span[1])
    lit = finite & (swept.shrink > 0)
    index, there = rows_under(lit, places)
    picked = jax.tree.map(lambda x: x.at[index].get(mode="fill", fill_value=1), transients)
    fine = is_valid(still(picked.gaussians).gaussians)
    fine = fine & jnp.all(jnp.isfinite(picked.velocity), axis=1)

    def fill_missing(x: Array) -> Array:
        return jnp.where(fine.reshape(-1, *(1,) * (x.ndim - 1)), x, 1)

    picked = jax.tree.map(fill_missing, picked)
    opacity = jnp.where(there & fine, picked.opacity, 0)
    return AliveTransients(
        transients=eqx.tree_at(lambda t: t.opacity, picked, opacity),
        index=jnp.where(there, index, -1),
        needed=jnp.sum(lit, dtype=jnp.int32),
        unusable=jnp.sum(~finite, dtype=jnp.int32) + jnp.sum(~fine, dtype=jnp.int32),
    )
