"""What the steps of a segment are compiled for: their options, and the sizes of their lists."""

from collections.abc import Hashable

import numpy as np

from gaussray.camera.array import rays_per_pixel
from gaussray.reconstruct.block_sizes import BlockSizes
from gaussray.reconstruct.data.batches import Batch
from gaussray.reconstruct.optimize.optimizer import transients_of
from gaussray.reconstruct.optimize.rows import occupied, take_rows
from gaussray.reconstruct.optimize.state import State
from gaussray.reconstruct.run_progress import RunProgress, SavedSizes
from gaussray.reconstruct.session import Session
from gaussray.reconstruct.step import measure_sizes
from gaussray.reconstruct.step_loss import StepOptions
from gaussray.runtime.devices import from_primary
from gaussray.tracer.alive_transients import most_alive
from gaussray.tracer.measure import kernel_capacity
from gaussray.tracer.options import grid_levels, on_kernel
from gaussray.tracer.traverse import Capacity


# Sizes of what tiles see: persistent and transient Gaussians.
_SEEN = 2
# Places for transient Gaussians that are alive: as many times as many as there are at first, and at
# least a share of the rows, but no more than so many.
_MORE_PLACES, _SHARE_OF_ROWS, _MOST_OF_SHARE = 1.25, 0.25, 1 << 16


def step_options(session: Session, stage: str) -> StepOptions:
    """The options of the steps of a stage.

    In the coarse stage of a scene that moves, only what cameras make of colours is refined: the
    scene is not formed yet and would form around the cameras' errors. After the first segment the
    cameras are known.

    Args:
        session: the segment.
        stage: coarse or fine.
    """
    options, refine = session.options, session.options.fit.refine
    if session.is_continuation:
        refine = ()
    elif stage == "coarse" and len(session.times) > 1:
        refine = tuple(kind for kind in refine if kind in ("exposure", "color_matrix"))
    return StepOptions(
        options.loss,
        options.optimizer,
        options.trace,
        samples=options.fit.samples or rays_per_pixel(session.footage.camera),
        footprint=options.fit.footprint,
        refine=refine,
        formed=session.is_continuation,
        degree_interval=options.fit.degree_interval,
        density=options.density,
        backdrop=session.backdrop,
        silhouettes=session.silhouettes,
        still=stage == "coarse" and session.still_first,
        at_rest=session.at_rest,
    )


def first_sizes(session: Session, state: State, batches: Batch) -> BlockSizes:
    """The sizes to compile the steps of a stage for, with room for what density control adds.

    Gaussians that replace each other are smaller, so lists grow more slowly than their number. The
    lists of the CUDA kernel take little memory, so they are not measured.

    Args:
        session: the segment.
        state: the state before the first step.
        batches: the tiles of a block, of which the first step is measured where it must be.
    """
    mesh, keys, density = session.mesh, session.key_states(state), session.options.density
    count = gaussian_count(state)
    if on_kernel(session.options.trace, session.footage.camera.time.dtype):
        capacity = kernel_capacity(_levels(session), _places_alive(session, state))
        return BlockSizes(capacity, mesh, keys)
    sizes = measure_sizes(
        state,
        session.footage.camera,
        batches,
        session.cameras,
        options=step_options(session, "fine"),
        mesh=mesh,
        keys=keys,
        growth=(density.room(count) / max(count, 1)) ** 0.5 if density.interval else 1.0,
    )
    return _sizes([int(n) for n in from_primary(np.array(_numbers(sizes)))], session, state)


def _places_alive(session: Session, state: State) -> int:
    """Places for the transient Gaussians that are alive at one time, a power of two: more than are
    at the times of the pictures, as density control adds some."""
    free = state.parameters.transient
    if free is None:
        return 0
    found = transients_of(take_rows(free, np.flatnonzero(occupied(free))), session.cameras.times)
    least = min(int(_SHARE_OF_ROWS * len(free.mean)), _MOST_OF_SHARE)
    wanted = max(int(_MORE_PLACES * most_alive(found, session.times)), least, 1)
    return 1 << (wanted - 1).bit_length()


def known_sizes(
    session: Session, stage: str, state: State, progress: RunProgress
) -> BlockSizes | None:
    """The sizes that an interrupted run was compiled for, or an earlier fit of the same pictures,
    so that this one goes on with the same programs; None where none are known for this stage and
    as many devices.

    Args:
        session: the segment.
        stage: coarse or fine.
        state: the state before the first step.
        progress: the progress so far, with the sizes of an interrupted run.
    """
    saved = progress.sizes
    if saved is None or not int(state.step):
        return session.shared.known(sizes_key(session, stage, state))
    levels = session.options.trace.levels + 1 if saved.levels is None else saved.levels
    here = progress.stage, session.mesh.size, _levels(session)
    if (saved.stage, saved.devices, levels) != here:
        return None
    if len(saved.sizes) not in (n := _least_numbers(session, state), n + _SEEN):
        return None
    return _sizes(list(saved.sizes), session, state)


def sizes_key(session: Session, stage: str, state: State) -> tuple[Hashable, ...]:
    """What decides which sizes the steps of a stage need: the rows of each kind of Gaussians, and
    what a step draws of them.

    Args:
        session: the segment.
        stage: coarse or fine.
        state: the state before or after the steps.
    """
    rows = tuple(len(part.mean) for part in state.parameters.kinds.values())
    options, keys = session.options, session.key_states(state)
    return "sizes", stage, rows, options.fit.tiles, options.fit.tile_side, options.trace, keys


def saved_sizes(stage: str, sizes: BlockSizes) -> SavedSizes:
    """The sizes as a checkpoint keeps them.

    Args:
        stage: coarse or fine.
        sizes: what the steps are compiled for.
    """
    levels = len(sizes.capacity.cells)
    return SavedSizes(stage, sizes.mesh.size, levels, tuple(_numbers(sizes)))


def gaussian_count(state: State) -> int:
    """How many Gaussians a state has."""
    return sum(int(occupied(part).sum()) for part in state.parameters.kinds.values())


def _numbers(sizes: BlockSizes) -> list[int]:
    """All sizes in a row: lists, transient Gaussians if there are any, and what tiles see."""
    capacity = sizes.capacity
    transient = [capacity.transient] if capacity.transient else []
    return [*capacity.cells, capacity.pairs, capacity.slots, *transient, *(sizes.seen or ())]


def _least_numbers(session: Session, state: State) -> int:
    """How many `_numbers` there are without those of what tiles see."""
    transient = state.parameters.transient is not None
    return _levels(session) + 2 + transient


def _levels(session: Session) -> int:
    """For how many levels of bundles a step finds cells."""
    return grid_levels(session.options.trace, session.footage.camera.time.dtype)


def _sizes(numbers: list[int], session: Session, state: State) -> BlockSizes:
    """The sizes of which `_numbers` gives the numbers."""
    levels, least = _levels(session), _least_numbers(session, state)
    capacity = Capacity(tuple(numbers[:levels]), *numbers[levels:least])
    seen = (numbers[-2], numbers[-1]) if len(numbers) > least else None
    return BlockSizes(capacity, session.mesh, session.key_states(state), seen)
