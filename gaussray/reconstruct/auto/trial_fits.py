"""Short fits of a capture, compared by pictures or tiles that none of them draws."""

import math
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from gaussray.capture.capture import Capture
from gaussray.reconstruct.data.held_out_tiles import HoldOut
from gaussray.reconstruct.data.segments import Segment
from gaussray.reconstruct.log import NonFiniteLoss, RunLog
from gaussray.reconstruct.optimize.state import State
from gaussray.reconstruct.options import ReconstructOptions
from gaussray.reconstruct.run_progress import RunProgress
from gaussray.reconstruct.session import Session
from gaussray.reconstruct.shared_results import SharedResults
from gaussray.runtime.devices import barrier, is_primary


# What the folders of fits of a trial are called.
_PREFIX = "trial_of_"
# Fits all stages of a segment.
Fitted = Callable[[Session, State | None, RunProgress], tuple[State, RunProgress]]


@dataclass(frozen=True)
class TrialFits:
    """Fits the first segment of a capture for a short time.

    Args:
        capture: the capture.
        segment: its first segment.
        out: the folder of the run; the trial's own is removed.
        fitted: fits all stages of a segment.
        shared: what these fits, and the one that follows, have in common.
        devices: how many devices share the rays (None: all).
        quiet: print no progress.
        at_once: whether the fits of a trial run at the same time (`Machine.runs_two_fits`).
    """

    capture: Capture
    segment: Segment
    out: Path
    fitted: Fitted
    shared: SharedResults
    devices: int | None = None
    quiet: bool = True
    at_once: bool = False

    def score(
        self,
        name: str,
        options: ReconstructOptions,
        hold_out: HoldOut,
        measure: Callable[[Session, State], float],
    ) -> float | None:
        """What is measured after a fit with these options; 0 if it failed, None if no tile can be
        held out.

        Args:
            name: what is tried, for progress bars (after "trial of"), and for the folder of the
                fit.
            options: all options; fit.validate is the share that `hold_out` gets.
            hold_out: which tiles no step draws.
            measure: measures the last state of the fit, in dB.
        """
        folder = self.out / f"{_PREFIX}{name.replace(' ', '_')}"
        _remove(folder)
        log = RunLog(folder, resume=False, interval=math.inf, writes=is_primary())
        segment = replace(self.segment, name=f"trial of {name}")
        session = Session(
            self.capture, log, options, self.quiet, self.devices, segment, hold_out, self.shared
        )
        if session.held_out is None:
            _remove(folder)
            return None
        try:
            state, _ = self.fitted(session, None, RunProgress())
            value = measure(session, state)
            return value if math.isfinite(value) else 0.0
        except NonFiniteLoss:
            return 0.0
        finally:
            del session
            _remove(folder)


def remove_killed_trials(out: Path) -> None:
    """Remove the folders of fits that were killed in an earlier trial.

    Args:
        out: the folder of the run.
    """
    for folder in out.glob(f"{_PREFIX}*"):
        shutil.rmtree(folder, ignore_errors=True)


def _remove(folder: Path) -> None:
    if is_primary():
        shutil.rmtree(folder, ignore_errors=True)
    barrier("trial")
