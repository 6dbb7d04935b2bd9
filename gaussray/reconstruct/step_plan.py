"""How many steps a stage takes: as its options say, or as many as fit into a time."""

import math
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from gaussray.reconstruct.run_progress import RunProgress, StageSchedule


# Steps before the pace is known, and the most of any timed stage.
_GUESS, _MOST = 3000, 200_000
# No timed stage takes fewer steps: with less, nothing has formed. Nor does one of what stands still
# where all that it does not show is taken as moving (experiments/captures/log.md).
FEWEST_STEPS, FEWEST_STILL_STEPS = 600, 1200
# Blocks between looks at held-out tiles.
_CHECK = 10
# Share of the plan before which no fit ends, and share of the steps so far that is added when
# held-out tiles no longer improve. Rates fall over it. While they are high, details do not form,
# and tiles seem to improve no more (experiments/captures/log.md).
_EARLIEST, _LAST = 0.5, 0.5
# Blocks whose median decides the pace; the first ones may wait for a compiler.
_BLOCKS = 5
# A block that takes so many times as long as others has waited for a compiler: for more rows or
# longer lists, or to score held-out tiles for the first time.
_WAITED = 4.0
# A plan of which half is done grows if there is time for so many times the steps that are left.
_GROWS = 1.25


class StepPlan:
    """A fixed number of steps.

    Args:
        schedule: how much of the stage is done at its steps.

    Attributes:
        schedule: that, as planned now. Learning rates fall with it.
        most: no stage takes more steps.
        stopped: the step at which held-out tiles no longer improved; 0 until then.
    """

    def __init__(self, schedule: StageSchedule):
        self.schedule = schedule
        self.most, self.stopped = self.steps, 0

    @property
    def steps(self) -> int:
        """The length of the stage."""
        return int(self.schedule.steps)

    def after_block(self, done: int, score: Callable[[], float] | None = None) -> bool:
        """Whether the plan has changed after a block.

        Args:
            done: steps of the stage that are done with the block.
            score: measures the PSNR of held-out tiles, in dB; None if there are none.
        """
        return False

    def noted(self, progress: RunProgress) -> RunProgress:
        """The progress, which keeps the plan for a run that is resumed."""
        return progress


class Plateau:
    """Tells when a score no longer improves.

    Args:
        patience: share of all steps so far that may pass without improvement.
        gain: what counts as improvement on the best score before.
        looks: scores without improvement, of which one alone may be chance.
    """

    def __init__(self, patience: float = 0.2, gain: float = 0.05, looks: int = 3):
        self._patience, self._gain, self._looks = patience, gain, looks
        self._best, self._since, self._worse = -np.inf, 0, 0

    def reached(self, step: int, score: float) -> bool:
        """Whether the score has not improved for too long; a NaN starts the wait anew.

        Args:
            step: steps that are done.
            score: the score after them, where more is better; NaN where it is not known.
        """
        self._worse += 1
        if math.isnan(score):
            # Unknown is no reason to end.
            self._since, self._worse = step, 0
        elif score > self._best + self._gain:
            self._best, self._since, self._worse = score, step, 0
        return self._worse >= self._looks and step - self._since > self._patience * step


class TimedPlan(StepPlan):
    """As many steps as fit into a time from the end of the first block on, in whole blocks.

    Reading, stereo and compilation, also later on, do not count: they differ most from machine to
    machine. There are at least `fewest` steps. The pace is measured during the first half; then the
    plan never shrinks, and grows where steps have become much faster. When held-out tiles no longer
    improve, half as many steps as were done follow. Over steps that are planned anew after the
    first half the learning rates fall from what they are to their end.

    Args:
        seconds: duration of the stage.
        block: steps of a block.
        fewest: no fewer steps are planned, however long they take.

    Attributes:
        seconds_of_fewest: seconds that the fewest steps take, if they are planned and take longer.
    """

    def __init__(self, seconds: float, block: int, fewest: int = FEWEST_STEPS):
        super().__init__(StageSchedule(_GUESS))
        self.most, self.seconds_of_fewest = _MOST, 0.0
        self.seconds, self._block, self._fewest = seconds, block, fewest
        # Steps that are done, and when; and seconds in which a compiler worked.
        self._marks: list[tuple[int, float]] = []
        self._waited = 0.0
        self._plateau = Plateau()

    def after_block(self, done: int, score: Callable[[], float] | None = None) -> bool:
        if self.stopped:
            return False
        paced = self._paced(done)
        if score is None or self._no_pace or (done // self._block) % _CHECK:
            return paced
        if not self._plateau.reached(done, score()) or done < _EARLIEST * self.steps:
            return paced
        blocks = -(-done // self._block) + max(int(_LAST * done / self._block), 1)
        steps = blocks * self._block
        if steps >= self.steps:
            return paced
        self.stopped, self.schedule = done, StageSchedule(steps, done, self.schedule.share_at(done))
        return True

    @property
    def _no_pace(self) -> bool:
        return len(self._marks) <= _BLOCKS

    def _paced(self, done: int) -> bool:
        now = time.monotonic()
        if not self._no_pace:
            before, when = self._marks[-1]
            usual = self._pace() * (done - before)
            # The median rises where all steps get slower, so that these count.
            if now - when > _WAITED * usual:
                self._waited += now - when - usual
        self._marks.append((done, now))
        if self._no_pace:
            return False
        end = self._marks[0][1] + self.seconds + self._waited
        left = max(end - now, 0) / max(self._pace(), 1e-9)
        blocks = max(int(max(done + left, self._fewest) / self._block), -(-done // self._block))
        steps = min(blocks * self._block, _MOST)
        if self.schedule.begin or (done > self.steps / 2 and self.steps != _GUESS):
            return self._grown(done, steps)
        fewest = self._fewest * self._pace()
        self.seconds_of_fewest = fewest if steps <= self._fewest and fewest > self.seconds else 0.0
        changed, self.schedule = steps != self.steps, StageSchedule(steps)
        return changed

    def _grown(self, done: int, steps: int) -> bool:
        """Whether the second half of the plan has become longer, of so many steps in all."""
        if done >= self.steps or steps - done < _GROWS * (self.steps - done):
            return False
        if steps - self.steps < _BLOCKS * self._block:
            return False
        self.schedule = StageSchedule(steps, done, self.schedule.share_at(done))
        self.seconds_of_fewest = 0.0
        return True

    def _pace(self) -> float:
        """Seconds that a step takes, the median of the last blocks."""
        step, when = np.array(self._marks[-_BLOCKS - 1 :]).T
        return float(np.median(np.diff(when) / np.diff(step)))

    def noted(self, progress: RunProgress) -> RunProgress:
        return replace(progress, planned=self.schedule)
