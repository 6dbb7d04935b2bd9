"""PSNR of held-out tiles."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jax.sharding import NamedSharding, PartitionSpec
from jaxtyping import Array, Float, Int

from gaussray.camera.array import CameraSet
from gaussray.camera.camera import Camera
from gaussray.color import psnr_from_mse
from gaussray.reconstruct.data.batches import Batch
from gaussray.reconstruct.optimize.state import State
from gaussray.reconstruct.step_loss import BlockSizes, StepOptions, loss_of
from gaussray.runtime.devices import everywhere


class _Error(NamedTuple):
    """Mean squared error of a batch, and what the tracer needed and dropped for lack of room."""

    mse: Float[Array, ""]
    needed: Int[Array, " sizes"]
    dropped: Int[Array, ""]


@eqx.filter_jit
def _square_error(
    state: State,
    views: Camera,
    batch: Batch,
    cameras: CameraSet,
    *,
    options: StepOptions,
    sizes: BlockSizes,
) -> _Error:
    _, details = loss_of(
        state.parameters, views, batch, cameras, state.step, options=options, sizes=sizes
    )
    report = details.report
    # Every host reads them.
    return jax.lax.with_sharding_constraint(
        _Error(details.terms["mse"], report.needed, report.dropped),
        NamedSharding(sizes.mesh, PartitionSpec()),
    )


def held_out_psnr(
    state: State,
    views: Camera,
    batches: Sequence[Batch],
    cameras: CameraSet,
    *,
    options: StepOptions,
    sizes: BlockSizes,
    enlarge: bool = False,
) -> float:
    """PSNR in dB of all pixels of the held-out tiles together.

    Args:
        state: what is scored.
        views: the recorded cameras of all training frames, stacked.
        batches: the held-out tiles (`held_out_batches`).
        cameras: the set of training cameras.
        options: how a step renders.
        sizes: what steps are compiled for.
        enlarge: compile for larger sizes where the tracer has no room for a batch. Else such
            batches do not count, and the result is NaN if these are more than half.
    """
    errors, weights = [], []
    for batch in batches:
        drawn = everywhere(batch, sizes.mesh)
        while True:
            mse, needed, dropped = _square_error(
                state, views, drawn, cameras, options=options, sizes=sizes
            )
            if not (enlarge and int(dropped)):
                break
            sizes = sizes.enlarged(needed)
        if not int(dropped):
            errors.append(float(mse))
            weights.append(_distinct_pixels(batch))
    if 2 * len(errors) < len(batches) or not sum(weights):
        return math.nan
    return psnr_from_mse(float(np.average(errors, weights=weights)))


def _distinct_pixels(batch: Batch) -> int:
    """Pixels that count, of a batch that may hold a tile several times."""
    place = np.stack([np.asarray(batch.frame), np.asarray(batch.tile)])
    _, first = np.unique(place, axis=1, return_index=True)
    if batch.visible is None:
        return len(first) * batch.side**2
    return int(np.asarray(batch.visible)[first].sum())
