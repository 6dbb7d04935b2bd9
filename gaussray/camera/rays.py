"""Rays in world space."""

import equinox as eqx
from jaxtyping import Array, Float


class Rays(eqx.Module):
    """Half-lines in world space, each with the time at which it sees the scene.

    A ray of unit `direction` and any `origin`; `time` is in the capture's unit. A ray that a lens
    cannot form (outside its field of view) has direction zero and meets nothing. `weight` is what
    its light counts for (`aperture.transmitted`); None is 1.
    """

    origin: Float[Array, "*rays 3"]
    direction: Float[Array, "*rays 3"]
    time: Float[Array, "*rays"]
    weight: Float[Array, "*rays"] | None = None
