"""Gradients of the loss by the mean of each Gaussian, which density control reads."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float


class GradientStatistic(eqx.Module):
    """Sum of |dL/dmean| x distance / 2 over the steps in which a Gaussian was seen (`total`), and
    the number of those steps (`seen`)."""

    total: Float[Array, " gaussians"]
    seen: Float[Array, " gaussians"]


def no_gradient(count: int) -> GradientStatistic:
    """The statistic of `count` Gaussians before the first step."""
    return GradientStatistic(jnp.zeros(count), jnp.zeros(count))


def accumulate(
    statistic: GradientStatistic,
    gradient: Float[Array, "gaussians 3"],
    distance: Float[Array, " gaussians"],
) -> GradientStatistic:
    """The statistic after one more step (3DGRT).

    The gradient of the 3D mean is multiplied by the distance to the cameras and halved, so that
    near and far Gaussians count by how far they move in the picture.

    Args:
        statistic: the statistic before the step.
        gradient: gradient of the loss by each mean; 0: the step did not see the Gaussian.
        distance: distance of each mean from the cameras, in scene units.
    """
    strength = jnp.sqrt(jnp.sum(gradient * gradient, axis=-1))
    return GradientStatistic(
        statistic.total + 0.5 * strength * distance,
        statistic.seen + (strength > 0).astype(statistic.seen.dtype),
    )
