"""Blends vectors of Gaussians, such as normals, along rays in place of their colours."""

import dataclasses
from collections.abc import Callable

import jax.numpy as jnp
from jaxtyping import Array, Float

from gaussray.scene.gaussians import Gaussians
from gaussray.scene.harmonics import constant_harmonics
from gaussray.tracer.composite import Pixels
from gaussray.tracer.motion import Motion


def color_by_vector(
    motion: Motion, vector: Callable[[Gaussians], Float[Array, "*keys n 3"]], largest: float
) -> Motion:
    """Replace the colours of a scene's Gaussians by vectors.

    Light is not negative: colours are vector + 2 `largest`, which also bounds the overshoot of
    parabolas between key states. `blended_vector` subtracts it again.

    Args:
        motion: the scene.
        vector: the vector of Gaussians; it may differ from key to key.
        largest: bound of the absolute value of its components.
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
        light=None,
    )


def blended_vector(pixels: Pixels, largest: float) -> Float[Array, "*rays 3"]:
    """Sum of blending weight x vector on every ray.

    Args:
        pixels: traced rays of a scene from `color_by_vector`.
        largest: the same bound.
    """
    return pixels.color - 2 * largest * (1 - pixels.transmittance)[..., None]
