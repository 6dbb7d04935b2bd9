"""Removals of parts of a scene, each kept if it costs little enough on the training pictures."""

import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from gaussray.reconstruct.simplify.candidate import Candidate
from gaussray.reconstruct.simplify.candidate_meter import CandidateMeter
from gaussray.reconstruct.simplify.finished import finished_scene
from gaussray.reconstruct.simplify.summary import part_counts
from gaussray.runtime.progress import ProgressReport
from gaussray.scene.scene import Scene


# Measurements that bisection takes to come within a hundredth.
BISECTIONS = 8


class Removals:
    """Removes parts from a candidate one after another, each if it costs little enough.

    Args:
        candidate: the candidate to begin with.
        sizes: numbers of its parts (`part_counts`).
        meter: measures the PSNR of candidates.
        bound: the most that one removal may cost, in dB.
        report: called after every measurement, with what it was of.

    Attributes:
        candidate: what is left.
        psnr: its PSNR in dB.
        steps: what was tried, with its loss in dB, and what it changes.
    """

    def __init__(
        self,
        candidate: Candidate,
        sizes: dict[str, int],
        meter: CandidateMeter,
        bound: float,
        report: ProgressReport,
    ):
        self.candidate, self.meter, self.bound, self.sizes = candidate, meter, bound, sizes
        self._report, self._measured = report, 0
        self._plan = _measurements(candidate.scene, masked=meter.masked)
        self.begin("nothing")
        report(0, sum(self._plan.values()), "measures the scene")
        self.psnr = self._cost(candidate, "what does nothing")
        self.steps: list[dict[str, Any]] = []
        self._record("what does nothing", candidate, self.psnr, True)

    def remove(self, step: str, without: Candidate) -> bool:
        """Remove one part, if that costs little enough; whether it did.

        Args:
            step: name of the step in the report.
            without: the candidate without the part.
        """
        psnr = self._cost(without, step)
        removed = self.psnr - psnr <= self.bound
        self._record(step, without, psnr, removed)
        return removed

    def remove_most(self, step: str, count: int, without: Callable[[int], Candidate]) -> None:
        """Remove as many things as cost little enough, to a hundredth of them, by bisection: the
        cost grows with their number.

        Args:
            step: name of the step in the report.
            count: how many there are.
            without: the candidate without the first of them, by their number.
        """
        low, high, best = 0, count + 1, None
        tried = count
        while count and high - low > max(count // 100, 1):
            candidate = without(tried)
            psnr = self._cost(candidate, step, least=self.psnr - self.bound)
            if self.psnr - psnr <= self.bound:
                low, best = tried, (candidate, psnr)
            else:
                high = tried
            tried = (low + high) // 2
        if best is not None:
            self._record(step, *best, True)

    def begin(self, part: str) -> None:
        """Begin a part of the plan; parts before it are over, even if they took fewer
        measurements."""
        ends = dict(zip(self._plan, itertools.accumulate(self._plan.values()), strict=True))
        self._end = ends[part]
        self._measured = self._end - self._plan[part]

    def _cost(self, candidate: Candidate, step: str, least: float = -math.inf) -> float:
        psnr = self.meter.psnr(candidate, least=least)
        self._measured = min(self._measured + 1, self._end)
        self._report(self._measured, sum(self._plan.values()), step)
        return psnr

    def _record(self, step: str, candidate: Candidate, psnr: float, removed: bool) -> None:
        before, after = self.sizes, part_counts(finished_scene(candidate))
        changed = {k: [before[k], after[k]] for k in before if before[k] != after[k]}
        lost = round(self.psnr - psnr, 4)
        self.steps.append({"step": step, "taken": removed, "loss": lost, **changed})
        if removed:
            self.candidate, self.psnr, self.sizes = candidate, psnr, after


def _measurements(scene: Scene, *, masked: bool) -> dict[str, int]:
    """The largest number of measurements in each part of pruning."""
    degree = {
        name: int(np.sqrt(getattr(scene, name).harmonics.shape[1])) - 1
        for name in ("static", "moving")
    }
    sizes = part_counts(scene)
    plan = {"nothing": 1, "hidden": BISECTIONS * masked, "prune": BISECTIONS}
    plan |= {"shading": 1, "rest": BISECTIONS}
    return plan | {"reduce": sizes["heads"] + 2 * sizes["scales"]} | degree | {"rounding": 1}
