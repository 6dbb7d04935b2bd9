"""A uniform grid over the Gaussians, cut into cells of equal occupancy."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from gaussray.tracer.bundle import morton
from gaussray.tracer.motion import Motion, clipped_time, control_points, usable
from gaussray.tracer.response import reach
from gaussray.tracer.window import Sweep, TimeWindow, all_states, swept_between, swept_box


# Gaussians in one cell.
OCCUPANCY = 8


class Grid(eqx.Module):
    """Gaussians in the order of a uniform grid, and boxes around each run of OCCUPANCY of them.

    The order is that of the cells of a 512^3 grid along the Morton curve, large Gaussians apart
    from small ones (size classes a factor 16 apart), so that one huge Gaussian does not inflate the
    box of a crowd of tiny ones. Equal runs instead of equal cubes: a cell holds the same number
    however they crowd, so everything in one cube costs no more than an even spread, and nothing
    needs a capacity. `index` is padded with -1; `dropped` counts Gaussians that are not `usable`.
    Where some Gaussians are transient, `fading` says when and where to (None: none are).
    """

    index: Int[Array, "cells occupancy"]
    center: Float[Array, "keys cells occupancy 3"]
    axes: Float[Array, "keys cells occupancy 3 3"]
    lower: Float[Array, "cells 3"]
    upper: Float[Array, "cells 3"]
    dropped: Int[Array, ""]
    fading: "Fading | None" = None


class Fading(eqx.Module):
    """Windows of the Gaussians of a grid, their reach at full opacity in standard deviations, and
    the times beyond which they rest."""

    window: TimeWindow
    radius: Float[Array, "*gaussians"]
    time_range: Float[Array, "2"] | None

    def between(
        self, earliest: Float[Array, "*windows"], latest: Float[Array, "*windows"]
    ) -> Sweep:
        """What the Gaussians do between two times."""
        earliest, latest = (clipped_time(self.time_range, x) for x in (earliest, latest))
        return swept_between(self.window, self.radius, earliest, latest)


def build_grid(motion: Motion, *, alpha_min: float, span: Float[Array, "2"] | None = None) -> Grid:
    """Sort the Gaussians into cells and bound each cell over all control points of the motion.

    The ellipsoids reach to where alpha = `alpha_min` (`response.reach`); Gaussians that never rise
    above it are left out, and so are transient ones that do not within the `span` of time that the
    grid is for. ValueError if there are transient ones and no span.
    """
    motion = jax.lax.stop_gradient(motion)
    g, window = all_states(motion)
    mean, frame = control_points(Motion(motion.time, g))
    radius = reach(g.opacity, alpha_min)
    support = frame * radius[None, :, None, None]
    lower, upper = around(mean, support)
    lower, upper = jnp.min(lower, axis=0), jnp.max(upper, axis=0)
    fine = usable(g)
    kept, fading = fine & (radius > 0), None
    if window is not None:
        if span is None:
            raise ValueError("a grid over transient Gaussians needs a span of time, got none.")
        fading = Fading(window, radius, motion.time_range)
        swept = fading.between(span[0], span[1])
        kept = kept & (swept.shrink > 0)
        lower, upper = swept_box(lower, upper, swept)
    order = jnp.argsort(place(lower, upper, kept))
    cells = max(-(-g.count // OCCUPANCY), 1)
    padding = cells * OCCUPANCY - g.count
    index = jnp.where(kept[order], order.astype(jnp.int32), -1)
    index = jnp.pad(index, (0, padding), constant_values=-1).reshape(cells, OCCUPANCY)
    there = (index >= 0)[..., None]
    take = jnp.maximum(index, 0)
    empty = g.count == 0
    pick = (
        (lambda x: jnp.zeros((*take.shape, *x.shape[1:]), x.dtype))
        if empty
        else (lambda x: x[take])
    )
    return Grid(
        index=index,
        center=jax.vmap(pick)(mean),
        axes=jax.vmap(pick)(support),
        lower=jnp.min(jnp.where(there, pick(lower), jnp.inf), axis=1),
        upper=jnp.max(jnp.where(there, pick(upper), -jnp.inf), axis=1),
        dropped=jnp.sum(~fine, dtype=jnp.int32),
        fading=None
        if fading is None
        else Fading(jax.tree.map(pick, fading.window), pick(radius), motion.time_range),
    )


def around(
    mean: Float[Array, "*gaussians 3"], support: Float[Array, "*gaussians 3 3"]
) -> tuple[Float[Array, "*gaussians 3"], Float[Array, "*gaussians 3"]]:
    """Corners of the boxes around ellipsoids. Slack for rounding in the axes themselves, relative
    to the Gaussian and to its place."""
    eps = jnp.finfo(mean.dtype).eps
    half = jnp.sqrt(jnp.sum(support * support, axis=-1)) * (1 + 8 * eps) + 4 * eps * jnp.abs(mean)
    return mean - half, mean + half


def place(
    lower: Float[Array, "gaussians 3"],
    upper: Float[Array, "gaussians 3"],
    kept: Bool[Array, " gaussians"],
) -> Int[Array, " gaussians"]:
    """Sort key: size class, then the grid cell of the centre on the Morton curve."""
    center = 0.5 * (lower + upper)
    low = jnp.min(jnp.where(kept[:, None], center, jnp.inf), axis=0, initial=jnp.inf)
    high = jnp.max(jnp.where(kept[:, None], center, -jnp.inf), axis=0, initial=-jnp.inf)
    span = jnp.maximum(jnp.max(high - low), jnp.finfo(center.dtype).tiny)
    cell = jnp.clip((center - low[None]) / span * 511, 0, 511)
    cell = jnp.where(kept[:, None], cell, 0).astype(jnp.int32)
    # Classes a factor 16 apart around the typical size: within a class the order is spatial.
    octave = jnp.log2(jnp.where(kept, jnp.max(upper - lower, axis=-1), 1))
    typical = jnp.sum(jnp.where(kept, octave, 0)) / jnp.maximum(jnp.sum(kept), 1)
    size = jnp.clip(jnp.round((octave - typical) / 4) + 3, 0, 7).astype(jnp.int32)
    return jnp.where(kept, (size << 27) | morton(cell), jnp.iinfo(jnp.int32).max)
