"""PSNR of held-out tiles."""

import math
from collections.abc import Callable, Sequence
from functools import cache
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jax.sharding import NamedSharding, PartitionSpec
from jaxtyping import Array, Bool, Float, Int

from gaussray.camera.array import CameraSet
from gaussray.camera.camera import Camera
from gaussray.color import psnr_from_mse
from gaussray.reconstruct.block_sizes import BlockSizes
from gaussray.reconstruct.data.batches import Batch
from gaussray.reconstruct.data.held_out_tiles import held_out_batches
from gaussray.reconstruct.data.pictures import Footage
from gaussray.reconstruct.optimize.state import State
from gaussray.reconstruct.session import Session
from gaussray.reconstruct.step_loss import StepOptions, loss_of
from gaussray.reconstruct.step_setup import first_sizes, sizes_key, step_options
from gaussray.runtime.devices import from_primary, replicate


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
        drawn = replicate(batch, sizes.mesh)
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


def held_out_score(
    session: Session,
    state: State,
    seen: Footage | None = None,
    held: Bool[np.ndarray, "frames tiles"] | None = None,
) -> float:
    """PSNR in dB of tiles that no step has drawn, after a fit.

    Args:
        session: the segment.
        state: what is scored.
        seen: the training pictures, perhaps with fewer pixels that count; None: those of the
            session.
        held: the tiles; None: those that the session holds out.

    Raises:
        ValueError: there are no such tiles.
    """
    seen, held = seen or session.footage, session.held_out if held is None else held
    if held is None or not held.any():
        raise ValueError("fit.validate must be above 0 for tiles to be held out.")
    views, cameras = replicate((session.footage.camera, session.cameras), session.mesh)
    batches = held_out_batches(seen, held, session.options.fit.tiles)
    sizes = session.shared.known(sizes_key(session, "fine", state))
    sizes = sizes or first_sizes(session, state, jax.tree.map(lambda *x: np.stack(x), *batches))
    known, options = (
        replicate(from_primary(state), session.mesh),
        step_options(session, "fine"),
    )
    return held_out_psnr(known, views, batches, cameras, options=options, sizes=sizes, enlarge=True)


def held_out_scorer(
    session: Session, stage: str, views: Camera, cameras: CameraSet
) -> Callable[[State, BlockSizes], float] | None:
    """The PSNR of the held-out tiles as a function of the state; None if there are none.

    Args:
        session: the segment.
        stage: coarse or fine.
        views: the recorded cameras of all training frames, stacked.
        cameras: the set of training cameras.
    """
    if session.held_out is None:
        return None
    held, options = session.held_out, step_options(session, stage)

    @cache
    def batches() -> list[Batch]:
        # Only timed stages look at them.
        return held_out_batches(session.footage, held, session.options.fit.tiles)

    def score(state: State, sizes: BlockSizes) -> float:
        known = replicate(state, session.mesh)
        return held_out_psnr(known, views, batches(), cameras, options=options, sizes=sizes)

    return score


def _distinct_pixels(batch: Batch) -> int:
    """Pixels that count, of a batch that may hold a tile several times."""
    place = np.stack([np.asarray(batch.frame), np.asarray(batch.tile)])
    _, first = np.unique(place, axis=1, return_index=True)
    if batch.visible is None:
        return len(first) * batch.side**2
    return int(np.asarray(batch.visible)[first].sum())
