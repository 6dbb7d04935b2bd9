"""Progress bars, messages and warnings of a command, in one of several styles."""

import bisect
import contextlib
import itertools
import json
import re
import shutil
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextvars import ContextVar
from typing import Any, Protocol, runtime_checkable

from gaussray.runtime.jit_cache import compiled
from gaussray.runtime.output import emit
from gaussray.runtime.side_by_side import demand_wanted


# auto: a bar on a terminal, lines elsewhere.
STYLES = ("auto", "bar", "lines", "json", "quiet")
# Seconds between two reports.
_PACE = {"bar": 0.2, "lines": 5.0, "json": 1.0}
_BAR = 24
# What differs between warnings of one kind: names in quotes, paths and numbers.
_VARIABLE = re.compile(r"'[^']*'|\S*/\S*|[-+]?\d[\d.,e]*")

_style: ContextVar[str] = ContextVar("style", default="auto")
# Whether the terminal's last line is an unfinished progress bar.
_open = [False]


def check_style(style: str) -> None:
    """Raise a ValueError unless `style` is one of STYLES."""
    if style not in STYLES:
        raise ValueError(f"progress must be one of {', '.join(STYLES)}, got {style!r}.")


@contextlib.contextmanager
def progress_style(style: str) -> Iterator[None]:
    """Within the block, progress and messages have this style of STYLES."""
    check_style(style)
    token = _style.set(style)
    try:
        yield
    finally:
        _style.reset(token)


def style() -> str:
    """The style in force, with auto resolved: bar, lines, json or quiet."""
    chosen = _style.get()
    if chosen == "auto":
        return "bar" if sys.stderr.isatty() else "lines"
    return chosen


def tell(text: str, quiet: bool) -> None:
    """Print a message on stdout unless it is empty.

    Args:
        text: the message.
        quiet: whether nothing is printed.
    """
    if text and not quiet:
        say(text)


def say(text: str, event: str = "message", **facts: Any) -> None:
    """Print a message on stdout.

    Args:
        text: the message.
        event: message, result or error. The style quiet prints no messages.
        facts: further values; the style json prints an object of event, text and these.
    """
    end_line()
    if style() == "quiet" and event == "message":
        return
    if style() == "json":
        text = json.dumps({"event": event, "text": text} | facts)
    emit(f"{text}\n", sys.stdout)


@contextlib.contextmanager
def plain_warnings() -> Iterator[None]:
    """Within the block, a warning is one line on stderr: its text, without file and source line.

    Of warnings that differ in numbers, names in quotes and paths alone, the first one is shown at
    once, and how many others there were, with the last one, when the block ends. The same text
    again, of a capture that is opened once more, is not shown.
    """
    counts: dict[str, int] = {}
    last: dict[str, str] = {}
    shown: set[str] = set()

    def show(message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
        text = " ".join(str(message).split())
        if text in shown:
            return
        shown.add(text)
        kind = f"{category.__name__} {_VARIABLE.sub('*', text)}"
        counts[kind] = counts.get(kind, 0) + 1
        last[kind] = text
        if counts[kind] == 1:
            _warn(text)

    before, warnings.showwarning = warnings.showwarning, show
    try:
        yield
    finally:
        warnings.showwarning = before
        for kind, count in counts.items():
            if count > 1:
                _warn(f"{count - 1} more like this, the last: {last[kind]}")


def _warn(text: str) -> None:
    """A warning on stderr, as one line."""
    end_line()
    emit(f"gaussray: warning: {text}\n", sys.stderr)


def end_line() -> None:
    """Start a new line if the terminal's last line is a progress bar."""
    if _open[0]:
        emit("\n", sys.stderr)
        _open[0] = False


@runtime_checkable
class ProgressReport(Protocol):
    """Shows how far a piece of work is."""

    def __call__(self, done: int, total: int, note: str = "", /) -> None:
        """Report units of work.

        Args:
            done: number of finished units.
            total: number of all units, the same in every call.
            note: further words about the work.
        """


def no_report(done: int, total: int, note: str = "") -> None:
    """A `ProgressReport` that shows nothing.

    Args:
        done: number of finished units.
        total: number of all units.
        note: further words about the work.
    """


class Progress:
    """Reports how much of a task is done, and estimates the remaining time.

    The estimate is the remaining cost times the seconds per cost in the later half of what is done,
    without compilation, plus, for each part that has not begun, the mean compilation time of the
    parts before it. It appears from the second report on.

    Args:
        name: name of the task.
        total: number of units.
        quiet: whether to report nothing.
        patience: a task shorter than this, in seconds, is not reported.
        parts: (units, cost of a unit) of each part, which may compile programs of its own. Empty:
            one part of equal units.
        anew: whether every unit may compile; compilation then counts as work.
        write: where reports go; None for stderr, or stdout in the style json.
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
        stream = sys.stdout if self.style == "json" else sys.stderr
        self.write = write or (lambda text: emit(text, stream))
        self.begin, self.before = time.monotonic(), compiled()
        # Cost done and seconds worked, at every report.
        self.costs: list[float] = []
        self.worked: list[float] = []
        self.shown = -float("inf")

    def change_total(self, total: int) -> None:
        """Change the number of units of a task whose units all cost the same."""
        self.total, self.parts = total, [(total, 1.0)]

    def report(self, done: int, note: str = "") -> None:
        """Report how many units are finished.

        Args:
            done: number of finished units since the beginning of the task.
            note: further words about the task, such as its loss.

        Raises:
            GivenUp: nobody wants the result any more (`run_side_by_side`).
        """
        demand_wanted()
        now = time.monotonic()
        spent, compiling = now - self.begin, 0.0 if self.anew else compiled() - self.before
        cost, whole = self._cost(done), self._cost(self.total)
        self.costs.append(cost)
        # What another thread compiles meanwhile is no time of this task's.
        self.worked.append(max(spent - compiling, self.worked[-1] if self.worked else 0.0))
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
        self._write(done, note, spent, left)

    def _firsts(self) -> list[int]:
        """The number of units before each part."""
        return [0, *itertools.accumulate(units for units, _ in self.parts)][:-1]

    def _cost(self, done: int) -> float:
        cost = 0.0
        for first, (units, each) in zip(self._firsts(), self.parts, strict=True):
            cost += each * min(max(done - first, 0), units)
        return cost

    def _write(self, done: int, note: str, spent: float, left: float | None) -> None:
        last = done >= self.total
        if self.style == "json":
            line = {"event": "progress", "work": self.name, "done": done, "total": self.total}
            line |= {"note": note, "spent": round(spent, 2)}
            line["left"] = None if left is None else round(left, 2)
            self.write(json.dumps(line) + "\n")
            return
        times = f"{_clock(spent)} spent" + ("" if left is None else f", {_clock(left)} left")
        if self.style == "lines":
            self.write(f"{self.name} {done}/{self.total}  {note}  {times}\n")
            return
        bar = _bar(done / max(self.total, 1), sys.stderr.encoding or "")
        text = f"{self.name:<12} {bar} {done}/{self.total}  {note}  {times}"
        width = shutil.get_terminal_size().columns - 1
        self.write(f"\r{text[:width]:<{width}}" + ("\n" if last else ""))
        _open[0] = not last


def _bar(share: float, encoding: str) -> str:
    """A progress bar, in characters that the terminal's encoding has."""
    full, rest = ("━", "╌") if "utf" in encoding.lower() else ("#", ".")
    count = round(_BAR * min(max(share, 0.0), 1.0))
    return full * count + rest * (_BAR - count)


def _clock(seconds: float) -> str:
    minutes, seconds = divmod(int(round(seconds)), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{seconds:02d}" if hours else f"{minutes}:{seconds:02d}"
