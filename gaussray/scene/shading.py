"""Shading of what stands still: shadows and reflected light that pass over it."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.scene.gaussians import Gaussians, times_factor


class Shading(eqx.Module):
    """Factor of the colours of static Gaussians, as a function of place and time.

    Its logarithm is given at the vertices of a regular grid and at some times. It is linear between
    them along each axis and over time, falls to 0 within one cell beyond the grid, and is constant
    before the first and after the last time. A Gaussian has the factor of the place of its mean,
    and within one picture (or the rows that are rendered together) that of the middle of its times.

    Args:
        lower: lower corner of the grid, in scene units.
        upper: upper corner of the grid, in scene units.
        time: increasing times, in the capture's unit.
        log_gain: natural logarithm of the factor at the vertices; two vertices or more on each
            axis.
    """

    lower: Float[Array, "3"]
    upper: Float[Array, "3"]
    time: Float[Array, " times"]
    log_gain: Float[Array, "times x y z"]

    def at(
        self, position: Float[Array, "places 3"], time: Float[Array, ""]
    ) -> Float[Array, " places"]:
        """The factor at places and one time.

        Args:
            position: in scene units.
            time: in the capture's unit.
        """
        count = len(self.time)
        row = jnp.interp(time, self.time, jnp.arange(count, dtype=self.time.dtype))
        first = jnp.clip(row.astype(jnp.int32), 0, max(count - 2, 0))
        share = row - first
        now = (1 - share) * self.log_gain[first]
        now = now + share * self.log_gain[jnp.minimum(first + 1, count - 1)]
        steps = np.array(now.shape, now.dtype) - 1
        place = (position - self.lower[None]) / (self.upper - self.lower)[None] * steps[None]
        return jnp.exp(jax.scipy.ndimage.map_coordinates(now, list(place.T), order=1, cval=0.0))

    def applied_to(
        self, gaussians: Gaussians, time: Float[Array, ""], *, held: bool = False
    ) -> Gaussians:
        """Gaussians in the shade of one time: the same colours times the factor, as harmonics.

        Args:
            gaussians: static Gaussians, as they are without shade.
            time: in the capture's unit.
            held: whether derivatives leave out how the factor depends on places.
        """
        place = jax.lax.stop_gradient(gaussians.mean) if held else gaussians.mean
        return times_factor(gaussians, self.at(place, time)[:, None])
