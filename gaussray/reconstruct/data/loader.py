"""Batches of tiles for blocks of steps, prepared while the device works on the block before."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from gaussray.reconstruct.data.batches import Batch, gather
from gaussray.reconstruct.data.motion_mask import Activity
from gaussray.reconstruct.data.pictures import Footage
from gaussray.reconstruct.data.sampler import Sampler, TileErrors, TileErrorState
from gaussray.reconstruct.step_plan import StepPlan


class GrowingWindow(NamedTuple):
    """The times that the coarse stage sees, and the fine stage at first, which then grow to all.

    Where control points learn how things move, what stands almost still for a short while gets its
    form there, and is followed from there to both ends.

    Args:
        anchor: the time around which steps look first.
        share: of the capture's time, that is seen at first.
        least: times that are seen at least.
        grown: share of the fine stage after which all times are seen.
        steps_each: steps for each time, after which all are, if that is earlier.
    """

    anchor: float
    share: float = 0.0
    least: int = 1
    grown: float = 0.0
    steps_each: int = 6

    def among(
        self, times: Float[np.ndarray, " instants"], stage: str, done: int, passed: float
    ) -> Int[np.ndarray, " seen"]:
        """Which of the times a step may see.

        Args:
            times: all times, increasing.
            stage: coarse or fine.
            done: steps of the stage before this one.
            passed: share of the stage that is done.
        """
        share = self.share
        if stage == "fine":
            part = 1.0
            if self.grown:
                part = max(passed / self.grown, done / (self.steps_each * len(times)))
            share += (1 - share) * min(part, 1.0)
        away = np.abs(times - self.anchor)
        least = np.sort(away)[min(self.least, len(times)) - 1]
        return np.flatnonzero(away <= max(share * away.max(), least))


class Loader:
    """Gives every step its tiles, all of one time, drawn by a `Sampler`.

    A block depends on seed, stage and step, and on the errors of the blocks before the last one.

    Args:
        footage: the training pictures.
        activity: where they change, which `moving_share` goes by.
        tiles: tiles that a step draws.
        moving_share: share of the tiles drawn in proportion to their moving pixels, in [0, 1].
        error: share of the tiles drawn in proportion to their errors; 0: errors are not kept.
        seed: seed of all draws.
        held_out: tiles that are never drawn; None if there are none.
        window: the times that are seen at first; None: all.
    """

    def __init__(
        self,
        footage: Footage,
        activity: Activity,
        *,
        tiles: int,
        moving_share: float,
        error: float,
        seed: int,
        held_out: Bool[np.ndarray, "frames tiles"] | None = None,
        window: GrowingWindow | None = None,
    ):
        _, camera = np.unique(footage.viewpoints, return_inverse=True)
        self.footage, self.seed, self.window = footage, seed, window
        self.errors = TileErrors(camera, footage.pixel.shape[1]) if error else None
        visible = footage.visible_tiles()
        if held_out is not None:
            visible = ~held_out if visible is None else visible & ~held_out
        self.sampler = Sampler(
            footage.times,
            activity.moved,
            visible,
            tiles=tiles,
            moving_share=moving_share,
            error=error,
            errors=self.errors,
        )

    def batches(self, stage: str, done: int, size: int, passed: float = 1.0) -> Batch:
        """The tiles of a block of steps.

        Args:
            stage: coarse or fine.
            done: steps of the stage before the block; also seeds the draw.
            size: steps of the block.
            passed: share of the stage that is done, which decides how far the window is.
        """
        dice = np.random.default_rng([self.seed, stage == "fine", done])
        among = self.sampler.instants
        if self.window is not None:
            among = among[self.window.among(self.sampler.times[among], stage, done, passed)]
        instant = among[dice.integers(len(among), size=size)]
        frame, tile = self.sampler.draw(instant, dice)
        time = self.sampler.times[instant].astype(self.footage.times.dtype)
        return gather(self.footage, frame, tile, time)

    def blocks(
        self, stage: str, done: int, plan: StepPlan, block: int
    ) -> Iterator[tuple[int, Batch]]:
        """The blocks that are left of a stage, and the number of steps before each.

        A thread prepares the next block; its errors are raised here.

        Args:
            stage: coarse or fine.
            done: steps of the stage that are done already.
            plan: steps of the stage, at most and as planned now.
            block: steps of a block; the last block may be shorter.
        """
        steps = plan.most

        def drawn(at: int) -> Batch:
            return self.batches(stage, at, sizes[at], float(plan.schedule.share_at(at)))

        sizes = {at: min(block, steps - at) for at in range(done, steps, block)}
        ahead = None
        with ThreadPoolExecutor(1) as thread:
            for at, size in sizes.items():
                batches = ahead.result() if ahead else drawn(at)
                # Only now: this block was drawn without the errors of the last one, and a resumed
                # run must draw it the same way.
                if self.errors is not None:
                    self.errors.learn()
                after = at + size
                ahead = None
                if after in sizes:
                    ahead = thread.submit(drawn, after)
                yield at, batches

    def sees_all(self, stage: str, done: int, passed: float) -> bool:
        """Whether steps see all times.

        Args:
            stage: coarse or fine.
            done: steps of the stage before them.
            passed: share of the stage that is done.
        """
        times = self.sampler.times
        if self.window is None:
            return True
        return len(self.window.among(times, stage, done, passed)) == len(times)

    def note_errors(self, batches: Batch, error: np.ndarray) -> None:
        """Note the errors of a block's tiles; they count from the next block but one on.

        Args:
            batches: the block as `blocks` gave it.
            error: error of each of its tiles in the loss, (steps, tiles).
        """
        if self.errors is not None:
            self.errors.note_errors(np.asarray(batches.frame), np.asarray(batches.tile), error)

    def tile_errors(self) -> TileErrorState | None:
        """The errors that a checkpoint must hold; None if tiles are not drawn by error."""
        return None if self.errors is None else self.errors.state()

    def restore(self, tile_errors: TileErrorState | None) -> None:
        """Go on with the errors of a checkpoint."""
        if self.errors is not None and tile_errors is not None:
            self.errors.restore(tile_errors)
