"""Bounds on the scale of every Gaussian: what the training cameras resolve, and how far it is."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from gaussray.camera.array import CameraSet, nearest_camera_distance, pixel_spacing
from gaussray.reconstruct.optimize.optimizer import Parameters


# How much smaller the shortest axis of a Gaussian may be than the bound, as a logarithm: exp(1.1)
# is 3 times, so that flat Gaussians stay flat.
FLAT = 1.1


class ScaleBounds(NamedTuple):
    """Logarithms of the smallest and the largest scale of each Gaussian."""

    smallest: Float[Array, " gaussians"]
    largest: Float[Array, " gaussians"]


def scale_bounds(
    parameters: Parameters, cameras: CameraSet, footprint: float
) -> dict[str, ScaleBounds]:
    """The bounds of each Gaussian, by kind.

    A Gaussian smaller than the pixels is met by some of the rays that should see it and missed by
    others: it fits single training pixels and aliases in all other pictures. So the smallest scale
    is some pixels of the nearest camera: the 3D smoothing filter of Mip-Splatting, as a bound. The
    largest is the distance to the nearest camera, or the extent of the cameras if that is more: one
    that nothing holds, because hardly any ray meets it, would grow without end.

    They are computed once per block of steps, because distances to the cameras hardly change
    within one.

    Args:
        parameters: what is learnt; means count where they are without motion.
        cameras: the training cameras.
        footprint: the smallest scale in pixels, as a standard deviation; 0: no smallest scale.
    """

    def of_kind(mean: Float[Array, "gaussians 3"]) -> ScaleBounds:
        largest = jnp.log(jnp.maximum(nearest_camera_distance(cameras, mean), cameras.extent))
        if not footprint:
            return ScaleBounds(jnp.full_like(largest, -jnp.inf), largest)
        return ScaleBounds(jnp.log(footprint * pixel_spacing(cameras, mean) + 1e-30), largest)

    return {kind: of_kind(free.mean) for kind, free in parameters.kinds.items()}


def with_scale_bounds(parameters: Parameters, bounds: dict[str, ScaleBounds]) -> Parameters:
    """The parameters with all scales within their bounds; the shortest axis may be `FLAT` below
    the smallest.

    Args:
        parameters: what is learnt.
        bounds: the bounds of each kind of Gaussians (`scale_bounds`).
    """

    def bounded(scale: Float[Array, "gaussians 3"], bound: ScaleBounds):
        shortest = scale <= jnp.min(scale, axis=1, keepdims=True)
        least = bound.smallest[:, None]
        scale = jnp.maximum(scale, jnp.where(shortest, least - FLAT, least))
        return jnp.minimum(scale, bound.largest[:, None])

    scales = [bounded(parameters.kinds[kind].log_scale, bound) for kind, bound in bounds.items()]
    return eqx.tree_at(lambda p: [p.kinds[kind].log_scale for kind in bounds], parameters, scales)
