"""PSNR of held-out tiles."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import NamedSharding, PartitionSpec
from jaxtyping import Array

from gaussray.camera.array import CameraSet
from gaussray.camera.camera import Camera
from gaussray.color import psnr_from_mse
from gaussray.reconstruct.data.batches import Batch
from gaussray.reconstruct.optimize.state import State
from gaussray.reconstruct.step_loss import BlockSizes, StepOptions, loss_of
from gaussray.runtime.devices import everywhere


@eqx.filter_jit
def _square_error(
    state: State,
    views: Camera,
    batch: Batch,
    cameras: CameraSet,
    *,
    options: StepOptions,
    sizes: BlockSizes,
) -> Array:
    """Mean squared error of a batch, infinite where the tracer had no room for all of it."""
    _, details = loss_of(
        state.parameters, views, batch, cameras, state.step, options=options, sizes=sizes
    )
    value = jnp.where(details.report.dropped > 0, jnp.inf, details.terms["mse"])
    # Every host reads it.
    return jax.lax.with_sharding_constraint(value, NamedSharding(sizes.mesh, PartitionSpec()))


def held_out_psnr(
    state: State,
    views: Camera,
    batches: list[Batch],
    cameras: CameraSet,
    *,
    options: StepOptions,
    sizes: BlockSizes,
) -> float:
    """PSNR in dB of the held-out tiles, without batches for which the tracer had no room; NaN if
    these are more than half.

    Args:
        state: what is scored.
        views: the recorded cameras of all training frames, stacked.
        batches: the held-out tiles (`held_out_batches`).
        cameras: the set of training cameras.
        options: how a step renders.
        sizes: what steps are compiled for.
    """
    known = [
        float(_square_error(state, views, everywhere(batch, sizes.mesh), cameras,
                            options=options, sizes=sizes))
        for batch in batches
    ]  # fmt: skip
    finite = [value for value in known if np.isfinite(value)]
    return psnr_from_mse(float(np.mean(finite))) if 2 * len(finite) >= len(known) else math.nan
