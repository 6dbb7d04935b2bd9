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
) -> dict[str, Float[Array, " gaussians"]]:
    """Logarithm of the smallest scale of each Gaussian, by kind; nothing if `footprint` (the bound
    in pixels, as a standard deviation) is 0.

    A Gaussian smaller than the pixels is met by some of the rays that should see it and missed by
    others: it fits single training pixels and aliases in all other pictures. This is the 3D
    smoothing filter of Mip-Splatting, as a bound. It is computed once per block of steps, because
    distances to the cameras hardly change within one.
    """
    if not footprint:
        return {}
    return {
        kind: jnp.log(footprint * resolved(cameras, free.mean) + 1e-30)
        for kind, free in parameters.kinds.items()
    }


def with_smallest_scales(
    parameters: Parameters, bounds: dict[str, Float[Array, " gaussians"]]
) -> Parameters:
    """The parameters with no scale below its bound; the shortest axis may be `FLAT` below it."""

    def bounded(scale: Float[Array, "gaussians 3"], bound: Array) -> Float[Array, "gaussians 3"]:
        shortest = scale <= jnp.min(scale, axis=1, keepdims=True)
        return jnp.maximum(scale, jnp.where(shortest, bound[:, None] - FLAT, bound[:, None]))

    scales = [bounded(parameters.kinds[kind].log_scale, bound) for kind, bound in bounds.items()]
    return eqx.tree_at(lambda p: [p.kinds[kind].log_scale for kind in bounds], parameters, scales)
