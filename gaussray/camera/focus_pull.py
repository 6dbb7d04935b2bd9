"""A focus distance that changes over time."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.io.plain_values import readable, vector
from gaussray.io.validate import require


EASES = ("linear", "smooth")


class FocusPull(eqx.Module):
    """A focus distance that changes over time.

    The reciprocal of the distance is interpolated between knots, so that blur circles change their
    size evenly and infinity is an ordinary value. It is constant before the first and after the
    last knot.

    Args:
        time: times of the knots, strictly increasing, in the capture's unit.
        distance: focus distance at each knot in scene units, above 0; infinity is allowed.
        ease: "linear", or "smooth" (3x^2 - 2x^3: starts and ends at rest).

    Raises:
        ValueError: If a value breaks its rule.
    """

    time: Float[Array, " knots"] = eqx.field(converter=vector("aperture.focus_distance.time"))
    distance: Float[Array, " distances"] = eqx.field(
        converter=vector("aperture.focus_distance.distance")
    )
    ease: str = eqx.field(static=True, default="linear")

    def __check_init__(self):
        knots = self.time.shape[-1], self.distance.shape[-1]
        if knots[0] != knots[1] or knots[0] < 1:
            raise ValueError(
                "aperture.focus_distance must be one distance for each of at least one time, got "
                f"{knots[0]} times and {knots[1]} distances."
            )
        require(
            "aperture.focus_distance.time",
            self.time,
            lambda t: np.all(np.isfinite(t)) & np.all(np.diff(t) > 0),
            "finite and strictly increasing",
        )
        require("aperture.focus_distance.distance", self.distance, lambda f: f > 0, "above 0")
        if self.ease not in EASES:
            raise ValueError(
                f"aperture.focus_distance.ease must be one of {', '.join(EASES)}, "
                f"got {self.ease!r}."
            )

    def __repr__(self) -> str:
        return readable(self)


def pulled_focus(pull: FocusPull, time: Float[Array, ""]) -> Float[Array, ""]:
    """Focus distance at a time, in scene units; it may be infinity.

    Args:
        pull: the focus pull.
        time: any time, in the capture's unit.
    """
    closeness = 1 / pull.distance
    if pull.time.shape[0] > 1:
        before = jnp.searchsorted(pull.time, time, side="right") - 1
        before = jnp.clip(before, 0, pull.time.shape[0] - 2)
        start, end = pull.time[before], pull.time[before + 1]
        way = jnp.clip((time - start) / (end - start), 0, 1)
        if pull.ease == "smooth":
            way = way * way * (3 - 2 * way)
        closeness = (1 - way) * closeness[before] + way * closeness[before + 1]
    else:
        closeness = closeness[0]
    finite = closeness > 0
    return jnp.where(finite, 1 / jnp.where(finite, closeness, 1), jnp.inf)
