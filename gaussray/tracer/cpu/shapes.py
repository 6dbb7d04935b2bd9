"""The ellipsoids of a scene as the search of candidate lists in machine code reads them."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from gaussray.tracer.alive_transients import time_window_of
from gaussray.tracer.cpu.reach import SLACK, SPHERE_ROWS, STATE_ROWS, WINDOW_ROWS
from gaussray.tracer.motion import Motion, clipped_time, control_points, is_valid, still
from gaussray.tracer.response import reach_radius


class Shapes(NamedTuple):
    """Gaussians as the call reads them: those that are there all the time, then transient ones.

    Args:
        sphere: centre and radius of a sphere around the ellipsoid at all control points, number by
            number; a radius of minus infinity keeps a Gaussian out of all lists. Of transient
            ones around the ellipsoid at its instant, with their time windows (cpu/reach.py).
        row: of each Gaussian the centre and F^T times the reach for each control point, Gaussian by
            Gaussian; of transient ones for the only one, and the time window.
    """

    sphere: Float[Array, "numbers gaussians"]
    row: Float[Array, "gaussians numbers"]


def persistent_shapes(motion: Motion, alpha_min: float) -> tuple[Shapes, Int[Array, ""]]:
    """Gaussians that are there all the time, and how many of them are not finite.

    Args:
        motion: the scene.
        alpha_min: opacity below which nothing is seen.
    """
    g = motion.gaussians
    mean, frame = control_points(motion)
    radius, fine = reach_radius(g.opacity, alpha_min), is_valid(g)
    support = frame * radius[None, :, None, None]
    if mean.shape[0] == 1:
        longest = radius * _largest(g.scale[0])
    else:
        # Control points between keys have axes of any length and angle.
        longest = jnp.sqrt(jnp.max(jnp.sum(support * support, axis=(-2, -1)), axis=0))
    low, high = jnp.min(mean, axis=0).T, jnp.max(mean, axis=0).T
    way = jnp.sqrt(sum((b - a) ** 2 for a, b in zip(low, high, strict=True))) / 2
    slack = SLACK * sum(jnp.abs(x) for x in (*low, *high))
    size = (longest + way) * (1 + SLACK) + slack
    sphere = _sphere((low + high) / 2, size, fine, radius)
    return Shapes(jnp.stack(sphere), _states(mean, support)), jnp.sum(~fine, dtype=jnp.int32)


def transient_shapes(
    motion: Motion, span: Float[Array, "2"], alpha_min: float
) -> tuple[Shapes, Int[Array, ""]]:
    """Transient Gaussians, and how many of them are not finite.

    Args:
        motion: the scene.
        span: first and last time of all rays.
        alpha_min: opacity below which nothing is seen.
    """
    t = motion.transient
    if t is None:
        none = jnp.zeros((SPHERE_ROWS + WINDOW_ROWS, 0), jnp.float32)
        return Shapes(none, jnp.zeros((0, STATE_ROWS + WINDOW_ROWS), jnp.float32)), jnp.int32(0)
    own = still(t.gaussians)
    mean, frame = control_points(own)
    radius, fine = reach_radius(t.opacity, alpha_min), is_valid(own.gaussians)
    window, beyond = time_window_of(t), jnp.where(radius > 0, radius, 1)
    # A lifetime without end has rate 0: it is alive at all times.
    rate = jnp.where(window.rate > 0, window.rate, 1)
    length = jnp.where(window.rate > 0, (window.plateau + radius / rate) * (1 + SLACK), jnp.inf)
    fade = window.rate / beyond
    times = [*window.velocity.T, window.instant, length, window.plateau, fade]
    # With slack for the rounding of the way from the instant.
    ends = jnp.abs(clipped_time(motion.time_range, span)[:, None] - window.instant[None])
    moved = jnp.minimum(length, jnp.max(ends, axis=0))[:, None] * jnp.abs(window.velocity)
    slack = 4 * SLACK * _total(jnp.abs(mean[0]) + jnp.where(jnp.isfinite(moved), moved, 0))
    size = radius * _largest(t.scale) * (1 + SLACK) + slack
    sphere = jnp.stack([*_sphere(mean[0].T, size, fine, radius), *times])
    states = _states(mean, frame * radius[None, :, None, None])
    row = jnp.concatenate([states, jnp.stack(times, axis=1)], axis=1)
    return Shapes(sphere, row), jnp.sum(~fine, dtype=jnp.int32)


def _sphere(center: Array, size: Array, fine: Array, radius: Array) -> list[Array]:
    """Rows of spheres; those of Gaussians that no list may hold contain nothing."""
    return [*jnp.where(fine[None], center, 0), jnp.where(fine & (radius > 0), size, -jnp.inf)]


def _largest(x: Float[Array, "gaussians 3"]) -> Float[Array, " gaussians"]:
    return jnp.maximum(jnp.maximum(x[:, 0], x[:, 1]), x[:, 2])


def _total(x: Float[Array, "gaussians 3"]) -> Float[Array, " gaussians"]:
    return x[:, 0] + x[:, 1] + x[:, 2]


def _states(
    mean: Float[Array, "keys gaussians 3"], support: Float[Array, "keys gaussians 3 3"]
) -> Float[Array, "gaussians numbers"]:
    turned = jnp.swapaxes(support, -2, -1).reshape(*mean.shape[:2], 9)
    return jnp.concatenate([x for k in range(len(mean)) for x in (mean[k], turned[k])], axis=1)
