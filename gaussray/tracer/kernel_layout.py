"""The Gaussians as the CUDA kernels read them: rows, and boxes in the order of the grid."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from gaussray.scene.gaussians import Gaussians, principal_axes, whitening_matrix
from gaussray.scene.transient import Transients
from gaussray.tracer.alive_transients import swept_between, swept_box, time_window_of
from gaussray.tracer.grid import OCCUPANCY, ellipsoid_boxes, grid_key
from gaussray.tracer.motion import (
    Motion,
    clipped_time,
    control_points,
    is_valid,
    replace_invalid,
    still,
    tint_controls,
)
from gaussray.tracer.response import reach_radius


# Cells in a box of the coarser grid, one for each thread of a warp.
_CELLS = 32


class Rows(NamedTuple):
    """The Gaussians as the kernels read them, those that rest first.

    `extent` is the mean and the axes F to where alpha = alpha_min, `state` A = S^-1 R^T, mean,
    opacity, squared reach (-1 for what is never met) and the place among the moving, -1 for what
    rests and -2, -3, ... for transient ones, `keyed` F, mean and tint of the control points of
    those that move, `color` the harmonics and a tint, `window` velocity, instant, rate and plateau
    of the transient ones, which come last.
    """

    extent: Float[Array, "gaussians 12"]
    state: Float[Array, "gaussians 16"]
    keyed: Float[Array, "moving keys 16"]
    color: Float[Array, "gaussians columns"]
    window: Float[Array, "transients 8"]


def harmonic_count(motion: Motion) -> int:
    """Harmonics per channel of the Gaussians, the most that any of them has."""
    parts = (motion.gaussians, motion.rest, motion.transient)
    return max(g.harmonics.shape[1] for g in parts if g is not None)


def is_tinted(motion: Motion) -> bool:
    """Whether any Gaussian has a tint."""
    parts = (motion.gaussians, motion.rest)
    return any(g is not None and g.tint is not None for g in parts)


def gaussian_rows(
    motion: Motion, alpha_min: float, span: Float[Array, "2"]
) -> tuple[Rows, Float[Array, "gaussians 6"], Bool[Array, " gaussians"], Bool[Array, " gaussians"]]:
    """The Gaussians as the kernels read them.

    Args:
        motion: the Gaussians at their key times.
        alpha_min: alpha below which a Gaussian has no effect.
        span: first and last time of the rays.

    Returns:
        The rows, boxes around the Gaussians within the span (lower and upper corners), which
        Gaussians can be hit, and which are valid.
    """
    form = _RowFormat(alpha_min, is_tinted(motion), harmonic_count(motion))
    if motion.keys == 1:
        parts = [_resting(motion.gaussians, form)]
        keyed = jnp.zeros((1, 1, 16), motion.gaussians.mean.dtype)
    else:
        moving, keyed = _moving(motion, form)
        parts = [moving]
        if motion.rest is not None:
            parts.insert(0, _resting(still(motion.rest).gaussians, form))
    window = jnp.zeros((1, 8), keyed.dtype)
    if motion.transient is not None:
        transient, window = _transient(
            motion.transient, clipped_time(motion.time_range, span), form
        )
        parts.append(transient)
    extent, state, color, box, kept, fine = (jnp.concatenate(x) for x in zip(*parts, strict=True))
    return Rows(jax.lax.stop_gradient(extent), state, keyed, color, window), box, kept, fine


class _RowFormat(NamedTuple):
    """What all rows share: where Gaussians end, whether colours are tinted, and the number of
    harmonics per channel."""

    alpha_min: float
    tinted: bool
    coefficients: int


def _resting(g: Gaussians, form: _RowFormat):
    """Extent, state, colour, box, whether hit and whether valid, of Gaussians at one key."""
    fine = is_valid(g)
    g = replace_invalid(g, fine)
    mean, quat, scale = g.mean[0], g.quat[0], g.scale[0]
    radius = reach_radius(jax.lax.stop_gradient(g.opacity), form.alpha_min)
    kept = fine & (radius > 0)
    support = jax.lax.stop_gradient(principal_axes(quat, scale)) * radius[:, None, None]
    extent = jnp.concatenate([support.reshape(-1, 9), mean], axis=1)
    state = jnp.concatenate(
        [
            whitening_matrix(quat, scale).reshape(-1, 9),
            mean,
            _state_tail(g.opacity, radius, kept, jnp.full_like(radius, -1)),
        ],
        axis=1,
    )
    tint = None if not form.tinted else jnp.ones_like(mean) if g.tint is None else g.tint[0]
    lower, upper = ellipsoid_boxes(jax.lax.stop_gradient(mean), support)
    box = jnp.concatenate([lower, upper], axis=1)
    return extent, state, _colors(g.harmonics, tint, form), box, kept, fine


def _moving(motion: Motion, form: _RowFormat):
    """The same for Gaussians with key states, and the rows of their control points."""
    fine = is_valid(motion.gaussians)
    g = replace_invalid(motion.gaussians, fine)
    motion = Motion(motion.time, g)
    mean, frame = control_points(motion)
    radius = reach_radius(jax.lax.stop_gradient(g.opacity), form.alpha_min)
    kept = fine & (radius > 0)
    tint = tint_controls(motion)
    keyed = [frame.reshape(*frame.shape[:2], 9), mean, tint, jnp.zeros_like(mean[..., :1])]
    keyed = jnp.moveaxis(jnp.concatenate(keyed, axis=-1), 0, 1)
    number = jnp.arange(g.count, dtype=mean.dtype)
    blank = jnp.zeros((g.count, 12), mean.dtype)
    state = jnp.concatenate([blank, _state_tail(g.opacity, radius, kept, number)], axis=1)
    lower, upper = ellipsoid_boxes(
        *jax.lax.stop_gradient((mean, frame * radius[None, :, None, None]))
    )
    box = jnp.concatenate([jnp.min(lower, axis=0), jnp.max(upper, axis=0)], axis=1)
    white = jnp.ones((g.count, 3), mean.dtype) if form.tinted else None
    return (blank, state, _colors(g.harmonics, white, form), box, kept, fine), keyed


def _transient(transients: Transients, span: Float[Array, "2"], form: _RowFormat):
    """The same for transient Gaussians, and the rows of their windows."""
    window, gaussians = time_window_of(transients), still(transients.gaussians).gaussians
    extent, state, color, box, kept, fine = _resting(gaussians, form)
    number = -2 - jnp.arange(kept.shape[0], dtype=state.dtype)
    radius = jnp.sqrt(jnp.maximum(jax.lax.stop_gradient(state[:, 13]), 0))
    fixed = jax.lax.stop_gradient(window)
    swept = swept_between(fixed, radius, span[0], span[1])
    kept = kept & (swept.shrink > 0)
    state = state.at[:, 14].set(number)
    box = jnp.concatenate(swept_box(box[:, :3], box[:, 3:], swept), axis=1)
    ends = jnp.stack([window.instant, window.rate, window.plateau], axis=1)
    rows = jnp.concatenate([window.velocity, ends, jnp.zeros_like(ends[:, :2])], axis=1)
    return (extent, state, color, box, kept, fine), rows


def _state_tail(opacity: Array, radius: Array, kept: Array, number: Array) -> Array:
    """The last four columns of a state."""
    squared = jnp.where(kept, radius * radius, -1)
    return jnp.stack([opacity, squared, number, jnp.zeros_like(radius)], axis=1)


def _colors(harmonics: Array, tint: Array | None, form: _RowFormat) -> Array:
    """Harmonics and tint in one row, a multiple of four floats."""
    missing = form.coefficients - harmonics.shape[1]
    harmonics = jnp.pad(harmonics, ((0, 0), (0, missing), (0, 0)))
    parts = [harmonics.reshape(harmonics.shape[0], -1)] + ([] if tint is None else [tint])
    row = jnp.concatenate(parts, axis=1)
    return jnp.pad(row, ((0, 0), (0, -row.shape[1] % 4)))


def grid_boxes(
    box: Float[Array, "gaussians 6"], kept: Bool[Array, " gaussians"]
) -> tuple[Int[Array, " padded"], Float[Array, "cells 6"], Float[Array, "supers 6"]]:
    """Order of the Gaussians along the grid (-1 pads), boxes of cells and of _CELLS cells.

    An empty box is NaN, so that every comparison with it is false.

    Args:
        box: lower and upper corners of the box around each Gaussian, in scene units.
        kept: whether each Gaussian can be hit; others are in no box.
    """
    box = jax.lax.stop_gradient(box)
    lower, upper = box[:, :3], box[:, 3:]
    count = kept.shape[0]
    padding = max(-(-count // (OCCUPANCY * _CELLS)), 1) * OCCUPANCY * _CELLS - count
    order = jnp.argsort(grid_key(lower, upper, kept).astype(jnp.uint32)).astype(jnp.int32)
    order = jnp.pad(order, (0, padding), constant_values=-1)
    signed = jnp.where(kept[:, None], jnp.concatenate([lower, -upper], axis=1), jnp.inf)
    signed = jnp.concatenate([signed, jnp.full((1, 6), jnp.inf, box.dtype)])[order]
    cell = jnp.min(signed.reshape(-1, OCCUPANCY, 6), axis=1)
    super_ = jnp.min(cell.reshape(-1, _CELLS, 6), axis=1)

    def corners(x: Array) -> Array:
        x = jnp.where(x[:, :1] < jnp.inf, x, jnp.nan)
        return jnp.concatenate([x[:, :3], -x[:, 3:]], axis=1)

    return order, corners(cell), corners(super_)
