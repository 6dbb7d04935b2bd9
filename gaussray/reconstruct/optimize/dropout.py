"""Dropout: a training step without a random share of the Gaussians.

What few pictures show is easily learnt by heart: Gaussians close to a camera paint its picture and
stand before everything in the pictures of others. Where any of them may be missing, those behind
have to look right, too. The others are more opaque in the same measure, so that the mean picture
stays (DropGaussian, Park et al. 2025).
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from gaussray.scene.scene import Scene


class Dropout(NamedTuple):
    """Which Gaussians a step does without.

    Args:
        key: random key of the step.
        share: the probability that a Gaussian is left out, from 0 to below 1.
    """

    key: PRNGKeyArray
    share: Float[Array, ""]


def with_dropout(scene: Scene, dropout: Dropout) -> Scene:
    """The scene with opacities of 0 for Gaussians that are left out, and others in proportion.

    Opacities may exceed 1; the tracer bounds the alpha of a ray (`TraceOptions.alpha_max`).

    Args:
        scene: the scene.
        dropout: key and probability.
    """

    def opacities(scene: Scene) -> list[Array]:
        kinds = (scene.static, scene.moving, scene.transient)
        return [kind.opacity for kind in kinds if kind is not None]

    before = opacities(scene)
    after = []
    for key, opacity in zip(jax.random.split(dropout.key, len(before)), before, strict=True):
        kept = jax.random.bernoulli(key, 1 - dropout.share, opacity.shape)
        after.append(jnp.where(kept, opacity / (1 - dropout.share), 0.0))
    return eqx.tree_at(opacities, scene, after)
