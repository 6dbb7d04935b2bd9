"""How many steps a stage takes: as its options say, or as many as fit into a time."""

import time
from dataclasses import replace

import numpy as np

from gaussray.reconstruct.run_progress import RunProgress


# Steps before the pace is known, and the most of any timed stage.
_GUESS, _MOST = 3000, 200_000
# Blocks whose median decides the pace; the first ones may wait for a compiler.
_BLOCKS = 5


class StepPlan:
    """A fixed number of steps.

    Attributes:
        steps: the length of the stage, over which learning rates fall.
        most: no stage takes more steps.
    """

    def __init__(self, steps: int):
        self.steps = self.most = steps

    def after_block(self, done: int) -> bool:
        """Whether the plan has changed after the block that ended with step `done`."""
        return False

    def noted(self, progress: RunProgress) -> RunProgress:
        """The progress, which keeps the plan for a run that is resumed."""
        return progress


class TimedPlan(StepPlan):
    """As many steps as fit before `end` (of `time.monotonic`), in whole blocks.

    The pace is measured during the first half; then the plan stays. At least the first half of the
    blocks that measure it are done, however slow they are.
    """

    def __init__(self, end: float, block: int):
        super().__init__(_GUESS)
        self.most = _MOST
        self._end, self._block = end, block
        self._marks: list[tuple[int, float]] = []

    def after_block(self, done: int) -> bool:
        self._marks.append((done, time.monotonic()))
        if len(self._marks) <= _BLOCKS or (done > self.steps / 2 and self.steps != _GUESS):
            return False
        step, when = np.array(self._marks[-_BLOCKS - 1 :]).T
        pace = float(np.median(np.diff(when) / np.diff(step)))
        left = max(self._end - when[-1], 0) / max(pace, 1e-9)
        blocks = max(int((done + left) / self._block), -(-done // self._block))
        steps = min(blocks * self._block, _MOST)
        changed, self.steps = steps != self.steps, steps
        return changed

    def noted(self, progress: RunProgress) -> RunProgress:
        return replace(progress, planned=self.steps)
