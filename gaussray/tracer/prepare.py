"""Preparation of a scene for several traces within a time span: alive Gaussians and their grid."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from gaussray.camera.rays import Rays
from gaussray.tracer.alive_transients import AliveTransients, alive_transients
from gaussray.tracer.grid import Grid, build_grid
from gaussray.tracer.motion import Motion, clipped_time, merge_rest
from gaussray.tracer.options import TraceOptions, on_kernel
from gaussray.tracer.traverse import Capacity


class Prepared(eqx.Module):
    """A motion, prepared for rays within a span of time.

    Args:
        motion: the motion, with the transient Gaussians that are alive in the span.
        grid: the grid over its Gaussians; None if lists are found without one.
        span: first and last time of the rays.
        living: the transient Gaussians that are alive; None if there are none.
    """

    motion: Motion
    grid: Grid | None
    span: Float[Array, "2"]
    living: AliveTransients | None = None

    def with_transient_count(self, needed: Array, dropped: Array) -> tuple[Array, Array]:
        """List sizes and dropped entries, including those of transient Gaussians.

        Args:
            needed: list sizes of a trace.
            dropped: entries that it dropped.
        """
        if self.living is None:
            return needed, dropped
        lost = jnp.maximum(self.living.needed - self.living.index.shape[0], 0)
        return jnp.append(needed, self.living.needed), dropped + lost

    def skipped_count(self, others: Array) -> Array:
        """Number of Gaussians that are not finite.

        Args:
            others: number of those among the Gaussians of `motion`.
        """
        return others if self.living is None else others + self.living.unusable


def prepare(
    motion: Motion, span: Float[Array, "2"], *, options: TraceOptions, capacity: Capacity
) -> Prepared:
    """Prepare a motion for several traces within a span of time.

    Args:
        motion: the scene.
        span: the earliest and the latest time of any ray.
        options: how it will be traced.
        capacity: that of the traces.
    """
    alive, transient = None, motion.transient
    span = jax.lax.stop_gradient(span)
    if transient is not None:
        # At least one place: an array of nothing is no operand of a kernel.
        slots = max(min(capacity.transient, transient.count), 1)
        span_in_range = clipped_time(motion.time_range, span)
        if transient.count:
            alive = alive_transients(transient, span_in_range, slots, options.alpha_min)
        motion = replace(motion, transient=None if alive is None else alive.transients)
    grid = None
    if not on_kernel(options, motion.gaussians.mean.dtype):
        motion = merge_rest(motion)
        if capacity.cells:
            fixed = jax.lax.stop_gradient(motion)
            grid = build_grid(fixed, alpha_min=options.alpha_min, span=span)
    return Prepared(motion, grid, span, alive)


def prepare_for_rays(
    motion: Motion | Prepared, rays: Rays, options: TraceOptions, capacity: Capacity
) -> Prepared:
    """Prepare a motion for rays, unless it is prepared already.

    Args:
        motion: the motion.
        rays: the rays.
        options: options of the tracer.
        capacity: capacity of the traces.
    """
    if isinstance(motion, Prepared):
        return motion
    return prepare(motion, time_span(rays), options=options, capacity=capacity)


def time_span(rays: Rays) -> Float[Array, "2"]:
    """First and last time of rays; times that are not finite do not count."""
    time = jax.lax.stop_gradient(rays.time)
    real = jnp.isfinite(time)
    low = jnp.min(jnp.where(real, time, jnp.inf), initial=jnp.inf)
    return jnp.stack([low, jnp.max(jnp.where(real, time, -jnp.inf), initial=-jnp.inf)])
