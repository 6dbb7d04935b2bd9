"""What is told of work that lasts: how far it is, how long it will still take, what came of it."""

import bisect
import contextlib
import itertools
import json
import shutil
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextvars import ContextVar
from typing import Any

from gaussray.runtime.jit_cache import compiled


# auto is a bar on a terminal and lines elsewhere.
STYLES = ("auto", "bar", "lines", "json", "quiet")
# Seconds from one report to the next.
_PACE = {"bar": 0.2, "lines": 5.0, "json": 1.0}
_BAR = 24

_style: ContextVar[str] = ContextVar("style", default="auto")
# Whether a bar stands in the terminal's last line.
_open = [False]


def check_style(style: str) -> None:
    """ValueError unless there is such a style."""
    if style not in STYLES:
        raise ValueError(f"progress must be one of {', '.join(STYLES)}, got {style!r}.")


@contextlib.contextmanager
def told_as(style: str) -> Iterator[None]:
    """Within the block, work is told of in a style of STYLES."""
    check_style(style)
    token = _style.set(style)
    try:
        yield
    finally:
        _style.reset(token)


def style() -> str:
    """How work is told of here: bar, lines, json or quiet."""
    chosen = _style.get()
    if chosen == "auto":
        return "bar" if sys.stderr.isatty() else "lines"
    return chosen


def say(text: str, event: str = "message", **facts: Any) -> None:
    """A line on stdout; in the style json an object with the text and the facts, and in the style
    quiet only of an `event` that is more than a message: result or error."""
    end_line()
    if style() == "quiet" and event == "message":
        return
    if style() == "json":
        text = json.dumps({"event": event, "text": text} | facts)
    print(text, flush=True)


@contextlib.contextmanager
def plain_warnings() -> Iterator[None]:
    """Within the block, a warning is one line on stderr: its text, without file and source line."""

    def text(message: Warning | str, *_: Any, **__: Any) -> str:
        end_line()
        return f"gaussray: warning: {message}\n"

    before, warnings.formatwarning = warnings.formatwarning, text
    try:
        yield
    finally:
        warnings.formatwarning = before


def end_line() -> None:
    """Leave the line of a bar, if one stands there, to what is said next."""
    if _open[0]:
        sys.stderr.write("\n")
        sys.stderr.flush()
        _open[0] = False


class Progress:
    """How far a piece of work is. Nothing is said of work of less than `patience` seconds.

    Of `parts` = (units, cost of one), each may compile programs of its own; one part of equal units
    is the default. What is left takes the seconds per cost of the later half of what was done,
    without compilation, and for every part that has not begun what those before it took to compile.
    Where every unit may be of a new kind (`anew`), compilation is work like any other. It is told
    from the second report on.
    """

    def __init__(
        self,
        name: str,
        total: int,
        *,
        quiet: bool = False,
        patience: float = 0.0,
        parts: Sequence[tuple[int, float]] = (),
        anew: bool = False,
        write: Callable | None = None,
    ):
        self.name, self.total, self.patience, self.anew = name, total, patience, anew
        self.style = "quiet" if quiet else style() if write is None else "lines"
        self.parts = list(parts) or [(total, 1.0)]
        self.write = write or (sys.stdout if self.style == "json" else sys.stderr).write
        self.begin, self.before = time.monotonic(), compiled()
        # Cost done and seconds worked, at every report.
        self.costs: list[float] = []
        self.worked: list[float] = []
        self.shown = -float("inf")

    def report(self, done: int, note: str = "") -> None:
        """Say that `done` of the total are finished."""
        now = time.monotonic()
        spent, compiling = now - self.begin, 0.0 if self.anew else compiled() - self.before
        cost, whole = self._cost(done), self._cost(self.total)
        self.costs.append(cost)
        self.worked.append(spent - compiling)
        last = done >= self.total
        soon = now - self.shown < _PACE.get(self.style, 0.0) and not last
        if self.style == "quiet" or soon or spent < self.patience:
            return
        self.shown = now
        left = 0.0 if last else None
        i = min(bisect.bisect_left(self.costs, cost / 2), max(len(self.costs) - 2, 0))
        if cost > self.costs[i] and not last:
            begun = sum(first < done for first in self._firsts())
            pace = (self.worked[-1] - self.worked[i]) / (cost - self.costs[i])
            left = pace * (whole - cost) + compiling / begun * (len(self.parts) - begun)
        self._tell(done, note, spent, left, last)

    def _firsts(self) -> list[int]:
        """Units before each part."""
        return [0, *itertools.accumulate(units for units, _ in self.parts)][:-1]

    def _cost(self, done: int) -> float:
        cost = 0.0
        for first, (units, each) in zip(self._firsts(), self.parts, strict=True):
            cost += each * min(max(done - first, 0), units)
        return cost

    def _tell(self, done: int, note: str, spent: float, left: float | None, last: bool) -> None:
        if self.style == "json":
            told = {"event": "progress", "work": self.name, "done": done, "total": self.total}
            told |= {"note": note, "spent": round(spent, 2)}
            told["left"] = None if left is None else round(left, 2)
            self.write(json.dumps(told) + "\n")
            sys.stdout.flush()
            return
        times = f"{_clock(spent)} spent" + ("" if left is None else f", {_clock(left)} left")
        if self.style == "lines":
            self.write(f"{self.name} {done}/{self.total}  {note}  {times}\n")
            return
        bar = _bar(done / max(self.total, 1), sys.stderr.encoding or "")
        text = f"{self.name:<12} {bar} {done}/{self.total}  {note}  {times}"
        width = shutil.get_terminal_size().columns - 1
        self.write(f"\r{text[:width]:<{width}}" + ("\n" if last else ""))
        sys.stderr.flush()
        _open[0] = not last


def _bar(share: float, encoding: str) -> str:
    """A share of 1 as a bar, in signs that the terminal has."""
    full, rest = ("━", "╌") if "utf" in encoding.lower() else ("#", ".")
    count = round(_BAR * min(max(share, 0.0), 1.0))
    return full * count + rest * (_BAR - count)


def _clock(seconds: float) -> str:
    minutes, seconds = divmod(int(round(seconds)), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{seconds:02d}" if hours else f"{minutes}:{seconds:02d}"
