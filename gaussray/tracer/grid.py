"""A uniform grid over the Gaussians, cut into cells of equal occupancy."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from gaussray.tracer.alive_transients import Sweep, TimeWindow, all_states, swept_between, swept_box
from gaussray.tracer.bundle import morton
from gaussray.tracer.motion import Motion, clipped_time, control_points, is_valid
from gaussray.tracer.response import reach_radius


# Gaussians in one cell.
OCCUPANCY = 8


class Grid(eqx.Module):
    """Gaussians in the order of a uniform grid, and boxes around each run of OCCUPANCY of them.

    The order is that of the cells of a 512^3 grid along the Morton curve, large Gaussians apart
    from small ones (size classes a factor 16 apart), so that one huge Gaussian does not inflate the
    box of a crowd of tiny ones. A cell is a run of equal length, not a cube of equal size: it holds
    the same number of Gaussians wherever they are, so that dense regions cost no more than an even
    spread, and nothing needs a capacity. `index` is padded with -1; `dropped` counts invalid
    Gaussians (`is_valid`). `fading` holds the time windows of transient ones; None without any.
    """

    index: Int[Array, "cells occupancy"]
    center: Float[Array, "keys cells occupancy 3"]
    axes: Float[Array, "keys cells occupancy 3 3"]
    lower: Float[Array, "cells 3"]
    upper: Float[Array, "cells 3"]
    dropped: Int[Array, ""]
    fading: "Fading | None" = None


class Fading(eqx.Module):
    """Time windows of the Gaussians of a grid.

    Args:
        window: the windows.
        radius: reach at full opacity, in standard deviations.
        time_range: times beyond which transient Gaussians rest; None for no limits.
    """

    window: TimeWindow
    radius: Float[Array, "*gaussians"]
    time_range: Float[Array, "2"] | None

    def between(
        self, earliest: Float[Array, "*windows"], latest: Float[Array, "*windows"]
    ) -> Sweep:
        """Displacement and shrinking of the Gaussians between two times.

        Args:
            earliest: first time.
            latest: last time.
        """
        earliest, latest = (clipped_time(self.time_range, x) for x in (earliest, latest))
        return swept_between(self.window, self.radius, earliest, latest)


def build_grid(motion: Motion, *, alpha_min: float, span: Float[Array, "2"] | None = None) -> Grid:
    """Sort the Gaussians into cells and bound each cell over all control points of the motion.

    Args:
        motion: the Gaussians at their key times.
        alpha_min: alpha at which ellipsoids end (`response.reach_radius`). Gaussians that stay
            below it are left out.
        span: first and last time of the rays. Transient Gaussians that are not alive in it are left
            out.

    Raises:
        ValueError: There are transient Gaussians and no span.
    """
    motion = jax.lax.stop_gradient(motion)
    g, window = all_states(motion)
    mean, frame = control_points(Motion(motion.time, g))
    radius = reach_radius(g.opacity, alpha_min)
    support = frame * radius[None, :, None, None]
    lower, upper = ellipsoid_boxes(mean, support)
    lower, upper = jnp.min(lower, axis=0), jnp.max(upper, axis=0)
    fine = is_valid(g)
    included, fading = fine & (radius > 0), None
    if window is not None:
        if span is None:
            raise ValueError("a grid over transient Gaussians needs a span of time, got none.")
        fading = Fading(window, radius, motion.time_range)
        swept = fading.between(span[0], span[1])
        included = included & (swept.shrink > 0)
        lower, upper = swept_box(lower, upper, swept)
    order = jnp.argsort(grid_key(lower, upper, included))
    cells = max(-(-g.count // OCCUPANCY), 1)
    padding = cells * OCCUPANCY - g.count
    index = jnp.where(included[order], order.astype(jnp.int32), -1)
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


def ellipsoid_boxes(
    mean: Float[Array, "*gaussians 3"], support: Float[Array, "*gaussians 3 3"]
) -> tuple[Float[Array, "*gaussians 3"], Float[Array, "*gaussians 3"]]:
    """Lower and upper corners of the boxes around ellipsoids, widened for rounding errors.

    Args:
        mean: centres.
        support: principal axes as columns, as long as the semi-axes.
    """
    eps = jnp.finfo(mean.dtype).eps
    half = jnp.sqrt(jnp.sum(support * support, axis=-1)) * (1 + 8 * eps) + 4 * eps * jnp.abs(mean)
    return mean - half, mean + half


def grid_key(
    lower: Float[Array, "gaussians 3"],
    upper: Float[Array, "gaussians 3"],
    included: Bool[Array, " gaussians"],
) -> Int[Array, " gaussians"]:
    """Sort key of Gaussians: size class, then the grid cell of the centre on the Morton curve.

    Args:
        lower: lower corners of the boxes around the Gaussians.
        upper: upper corners.
        included: the Gaussians that enter the grid; the others come last.
    """
    center = 0.5 * (lower + upper)
    low = jnp.min(jnp.where(included[:, None], center, jnp.inf), axis=0, initial=jnp.inf)
    high = jnp.max(jnp.where(included[:, None], center, -jnp.inf), axis=0, initial=-jnp.inf)
    span = jnp.maximum(jnp.max(high - low), jnp.finfo(center.dtype).tiny)
    cell = jnp.clip((center - low[None]) / span * 511, 0, 511)
    cell = jnp.where(included[:, None], cell, 0).astype(jnp.int32)
    # Classes a factor 16 apart around the typical size: within a class the order is spatial.
    octave = jnp.log2(jnp.where(included, jnp.max(upper - lower, axis=-1), 1))
    typical = jnp.sum(jnp.where(included, octave, 0)) / jnp.maximum(jnp.sum(included), 1)
    size = jnp.clip(jnp.round((octave - typical) / 4) + 3, 0, 7).astype(jnp.int32)
    return jnp.where(included, (size << 27) | morton(cell), jnp.iinfo(jnp.int32).max)
