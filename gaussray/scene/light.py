"""Light that changes over time: lamps that flicker or are dimmed, clouds, the time of day."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from gaussray.scene.gaussians import Gaussians, times_factor


class Light(eqx.Module):
    """Factor of all that the scene emits, as a function of time.

    A ray sees its colour times the factor at its own time: linear between the times, constant
    before the first and after the last one.

    Args:
        time: increasing times, in the capture's unit.
        gain: factors of linear red, green and blue at these times, above 0.
    """

    time: Float[Array, " times"]
    gain: Float[Array, "times 3"]

    def at(self, time: Float[Array, "*rays"]) -> Float[Array, "*rays 3"]:
        """The factor at times.

        Args:
            time: in the capture's unit.
        """
        channels = [jnp.interp(time, self.time, self.gain[:, c]) for c in range(3)]
        return jnp.stack(channels, axis=-1)

    def applied_to(self, gaussians: Gaussians, time: Float[Array, ""]) -> Gaussians:
        """Gaussians in the light of one time: the same colours times the factor, as harmonics.

        Args:
            gaussians: as they are in the usual light.
            time: in the capture's unit.
        """
        return times_factor(gaussians, self.at(time)[None])
