"""How far long work is, and how long it will still take."""

import sys
import time
from collections.abc import Callable


class Progress:
    """One line per unit of work: rewritten in place on a terminal, every few seconds elsewhere.
    Nothing is said of work of less than `patience` seconds.

    The estimate is the elapsed time times what is left over what is done, leaving out the first
    report, in which compilation hides.
    """

    def __init__(
        self,
        name: str,
        total: int,
        *,
        quiet: bool = False,
        patience: float = 0.0,
        write: Callable | None = None,
    ):
        self.name, self.total, self.quiet, self.patience = name, total, quiet, patience
        self.begin = time.monotonic()
        self.first: tuple[int, float] | None = None
        self.shown = -float("inf")
        self.write = write or sys.stderr.write
        self.live = sys.stderr.isatty() and write is None

    def report(self, done: int, note: str = "") -> None:
        """Say that `done` of the total are finished."""
        now = time.monotonic()
        if self.first is None:
            self.first = (done, now)
        last = done >= self.total
        soon = now - self.shown < (0.2 if self.live else 5) and not last
        if self.quiet or soon or now - self.begin < self.patience:
            return
        self.shown = now
        start, since = self.first
        rate = (now - since) / (done - start) if done > start else (now - self.begin) / max(done, 1)
        spent, left = now - self.begin, rate * (self.total - done)
        text = (
            f"{self.name} {done}/{self.total}  {note}  {_clock(spent)} spent, {_clock(left)} left"
        )
        self.write(f"\r{text:<100}" + ("\n" if last else "") if self.live else f"{text}\n")


def _clock(seconds: float) -> str:
    minutes, seconds = divmod(int(round(seconds)), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{seconds:02d}" if hours else f"{minutes}:{seconds:02d}"
