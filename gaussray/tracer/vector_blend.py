"""Any vector of the Gaussians, blended along rays as if it were their colour."""

import dataclasses
from collections.abc import Callable

import jax.numpy as jnp
from jaxtyping import Array, Float

from gaussray.scene.gaussians import Gaussians
from gaussray.scene.harmonics import constant_harmonics
from gaussray.tracer.composite import Pixels
from gaussray.tracer.motion import Motion


def painted(
    motion: Motion, vector: Callable[[Gaussians], Float[Array, "*keys n 3"]], largest: float
) -> Motion:
    """The scene with `vector` of its Gaussians, which may differ from key to key, as their colours.

    Light is not negative: colours are vector + 2 `largest`, a bound of the vector's components and
    of how far a parabola may swing beyond those of its keys. `blended` takes that out again.
    """

    def paint(gaussians: Gaussians) -> Gaussians:
        color = vector(gaussians) + 2 * largest
        if color.ndim == 2:
            return dataclasses.replace(gaussians, harmonics=constant_harmonics(color, 0), tint=None)
        if color.shape[0] == 1:
            return dataclasses.replace(
                gaussians, harmonics=constant_harmonics(color[0], 0), tint=None
            )
        white = constant_harmonics(jnp.ones_like(color[0]), 0)
        return dataclasses.replace(gaussians, harmonics=white, tint=color)

    rest, transient = motion.rest, motion.transient
    if transient is not None:
        harmonics = paint(transient.gaussians).harmonics
        transient = dataclasses.replace(transient, harmonics=harmonics)
    return dataclasses.replace(
        motion,
        gaussians=paint(motion.gaussians),
        rest=None if rest is None else paint(rest),
        transient=transient,
    )


def blended(pixels: Pixels, largest: float) -> Float[Array, "*rays 3"]:
    """Sum of blending weight x vector on every ray of a `painted` scene."""
    return pixels.color - 2 * largest * (1 - pixels.transmittance)[..., None]
