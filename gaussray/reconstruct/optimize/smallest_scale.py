"""The smallest scale that the training cameras can resolve, as a bound on every Gaussian."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from gaussray.camera.array import CameraSet, resolved
from gaussray.reconstruct.optimize.optimizer import Parameters


# How much smaller the shortest axis of a Gaussian may be than the bound, as a logarithm: exp(1.1)
# is 3 times, so that flat Gaussians stay flat.
FLAT = 1.1


def smallest_scales(
    parameters: Parameters, cameras: CameraSet, footprint: float
) -> tuple[Float[Array, " static"], Float[Array, " moving"]] | None:
    """Logarithm of the smallest scale of each static and each moving Gaussian; None if `footprint`
    (the bound in pixels, as a standard deviation) is 0.

    A Gaussian smaller than the pixels is met by some of the rays that should see it and missed by
    others: it fits single training pixels and aliases in all other pictures. This is the 3D
    smoothing filter of Mip-Splatting, as a bound. It is computed once per block of steps, because
    distances to the cameras hardly change within one.
    """
    if not footprint:
        return None
    static, moving = (
        jnp.log(footprint * resolved(cameras, free.mean) + 1e-30)
        for free in (parameters.static, parameters.moving)
    )
    return static, moving


def with_smallest_scales(
    parameters: Parameters,
    bounds: tuple[Float[Array, " static"], Float[Array, " moving"]] | None,
) -> Parameters:
    """The parameters with no scale below its bound; the shortest axis may be `FLAT` below it."""
    if bounds is None:
        return parameters

    def bounded(scale: Float[Array, "gaussians 3"], bound: Array) -> Float[Array, "gaussians 3"]:
        shortest = scale <= jnp.min(scale, axis=1, keepdims=True)
        return jnp.maximum(scale, jnp.where(shortest, bound[:, None] - FLAT, bound[:, None]))

    parts = parameters.static, parameters.moving
    scales = [bounded(free.log_scale, bound) for free, bound in zip(parts, bounds, strict=True)]
    return eqx.tree_at(lambda p: [p.static.log_scale, p.moving.log_scale], parameters, scales)
