"""Rays in world space."""

import dataclasses

import equinox as eqx
from jaxtyping import Array, Float

from gaussray.io.plain_values import optional, readable, rows, vector


class Rays(eqx.Module):
    """Half-lines in world space, each with the time at which it sees the scene.

    Args:
        origin: start of each ray, in scene units.
        direction: unit vectors. A ray that a lens cannot form (outside its field of view) has
            direction zero and hits nothing.
        time: in the capture's unit.
        weight: factor of the light of each ray (gaussray.camera.aperture.transmitted); None is 1.
        start: distance from the origin at which each ray begins to see, in scene units; None is 0.

    Raises:
        ValueError: The parts are not of equally many rays.
    """

    origin: Float[Array, "*rays 3"] = eqx.field(converter=rows("rays.origin", 3))
    direction: Float[Array, "*rays 3"] = eqx.field(converter=rows("rays.direction", 3))
    time: Float[Array, "*rays"] = eqx.field(converter=vector("rays.time", spread=True))
    weight: Float[Array, "*rays"] | None = eqx.field(
        default=None, converter=optional(vector("rays.weight"))
    )
    start: Float[Array, "*rays"] | None = eqx.field(
        default=None, converter=optional(vector("rays.start"))
    )

    def __check_init__(self):
        parts = {"direction": 1, "time": 0, "weight": 0, "start": 0}
        counts = getattr(self.origin, "shape", None)
        for name, trailing in parts.items():
            shape = getattr(getattr(self, name), "shape", None)
            # Trees of other things than arrays have this type, too.
            if counts is None or shape is None:
                continue
            if shape[: len(shape) - trailing] != counts[:-1]:
                raise ValueError(
                    f"rays.{name} must be one for each ray, got the shape {tuple(shape)} where "
                    f"rays.origin has {tuple(counts)}. Repeat what several rays share."
                )

    def __repr__(self) -> str:
        return readable(self)


def moved_to_start(rays: Rays) -> Rays:
    """The same rays with their origins where they begin to see: `start` is None."""
    if rays.start is None:
        return rays
    origin = rays.origin + rays.start[..., None] * rays.direction
    return dataclasses.replace(rays, origin=origin, start=None)
