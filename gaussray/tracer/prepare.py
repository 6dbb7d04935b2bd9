"""What all traces of the same scene within a span of time share."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from gaussray.camera.rays import Rays
from gaussray.tracer.grid import Grid, build_grid
from gaussray.tracer.motion import Motion, clipped_time, with_rest
from gaussray.tracer.options import TraceOptions, on_kernel
from gaussray.tracer.traverse import Capacity
from gaussray.tracer.window import Living, living


class Prepared(eqx.Module):
    """A motion as all rays within a `span` of time may meet it.

    `motion` holds of the transient Gaussians those that are `living` in the span (None: there are
    no transient ones). `grid` is the one over them (None where the CUDA kernels trace).
    """

    motion: Motion
    grid: Grid | None
    span: Float[Array, "2"]
    living: Living | None = None

    def extended(self, needed: Array, dropped: Array) -> tuple[Array, Array]:
        """List sizes with the number of living transients, and entries without a place."""
        if self.living is None:
            return needed, dropped
        lost = jnp.maximum(self.living.needed - self.living.index.shape[0], 0)
        return jnp.append(needed, self.living.needed), dropped + lost

    def skipped(self, others: Array) -> Array:
        """How many Gaussians are not finite, given how many of the `others` are not."""
        return others if self.living is None else others + self.living.unusable


def prepare(
    motion: Motion, span: Float[Array, "2"], *, options: TraceOptions, capacity: Capacity
) -> Prepared:
    """What all traces of rays within a span of time share: worth it for several traces.

    Args:
        motion: the scene.
        span: the earliest and the latest time of any ray.
        options: how it will be traced.
        capacity: that of the traces.
    """
    chosen, transient = None, motion.transient
    span = jax.lax.stop_gradient(span)
    if transient is not None:
        # At least one place: an array of nothing is no operand of a kernel.
        places, seen = max(capacity.transient, 1), clipped_time(motion.time_range, span)
        if transient.count:
            chosen = living(transient, seen, places, options.alpha_min)
        motion = replace(motion, transient=None if chosen is None else chosen.transients)
    grid = None
    if not on_kernel(options, motion.gaussians.mean.dtype):
        motion = with_rest(motion)
        fixed = jax.lax.stop_gradient(motion)
        grid = build_grid(fixed, alpha_min=options.alpha_min, span=span)
    return Prepared(motion, grid, span, chosen)


def prepared_for(
    motion: Motion | Prepared, rays: Rays, options: TraceOptions, capacity: Capacity
) -> Prepared:
    """A motion prepared for these rays, unless it is prepared already."""
    if isinstance(motion, Prepared):
        return motion
    return prepare(motion, span_of(rays), options=options, capacity=capacity)


def span_of(rays: Rays) -> Float[Array, "2"]:
    """The earliest and the latest time of rays; times that are not finite do not count."""
    time = jax.lax.stop_gradient(rays.time)
    real = jnp.isfinite(time)
    low = jnp.min(jnp.where(real, time, jnp.inf), initial=jnp.inf)
    return jnp.stack([low, jnp.max(jnp.where(real, time, -jnp.inf), initial=-jnp.inf)])
