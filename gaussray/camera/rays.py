"""Rays in world space."""

import equinox as eqx
from jaxtyping import Array, Float

from gaussray.io.plain_values import optional, readable, rows, vector


class Rays(eqx.Module):
    """Half-lines in world space, each with the time at which it sees the scene.

    A ray of unit `direction` and any `origin`; `time` is in the capture's unit. A ray that a lens
    cannot form (outside its field of view) has direction zero and meets nothing. `weight` is what
    its light counts for (gaussray.camera.aperture.transmitted); None is 1.
    """

    origin: Float[Array, "*rays 3"] = eqx.field(converter=rows("rays.origin", 3))
    direction: Float[Array, "*rays 3"] = eqx.field(converter=rows("rays.direction", 3))
    time: Float[Array, "*rays"] = eqx.field(converter=vector("rays.time", spread=True))
    weight: Float[Array, "*rays"] | None = eqx.field(
        default=None, converter=optional(vector("rays.weight"))
    )

    def __repr__(self) -> str:
        return readable(self)
