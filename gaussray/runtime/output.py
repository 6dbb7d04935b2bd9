"""Text on stdout and stderr, whose reader may have gone."""

import os
from collections.abc import Sequence
from typing import Any


# Fewest neighbours that make a range.
_RANGE = 3


def emit(text: str, stream: Any) -> None:
    """Write text to a stream at once.

    Once nobody reads a pipe any more (`gaussray reconstruct ... | head`), this text and all later
    text is dropped, and the work goes on.

    Args:
        text: the text, with its line break.
        stream: sys.stdout or sys.stderr.
    """
    try:
        stream.write(text)
        stream.flush()
    except BrokenPipeError:
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), stream.fileno())


def first_of(names: Sequence[str], most: int = 3) -> str:
    """The first of some names, with dots if there are more: `a, b, c ...`.

    Args:
        names: all of them.
        most: how many are told.
    """
    return ", ".join(names[:most]) + " ..." * (len(names) > most)


def listed_names(names: Sequence[str], everyone: Sequence[str] = (), most: int = 8) -> str:
    """Names as in `a1 to a5, b2 and 7 others`.

    Args:
        names: those that are told, in order.
        everyone: all names in order, in which neighbours follow each other; none makes no ranges.
        most: how many names and ranges are told.
    """
    place = {name: k for k, name in enumerate(everyone)}
    runs: list[list[str]] = []
    for name in names:
        if runs and name in place and place[name] - 1 == place.get(runs[-1][-1]):
            runs[-1].append(name)
        else:
            runs.append([name])
    parts = [
        part for run in runs for part in ([run] if len(run) >= _RANGE else [[name] for name in run])
    ]
    told = [part[0] if len(part) == 1 else f"{part[0]} to {part[-1]}" for part in parts[:most]]
    left = sum(map(len, parts[most:]))
    more = f" and {left} other{'s' * (left > 1)}" if left else ""
    return ", ".join(told) + more


def counted(count: int, noun: str) -> str:
    """A number and what it counts: `1 picture`, `2,000 pictures`.

    Args:
        count: the number.
        noun: what one of them is called.
    """
    return f"{count:,} {noun}{'s' * (count != 1)}"


def minutes_text(minutes: float) -> str:
    """A number of minutes with its noun: `1 minute`, `1.5 minutes`, `12 minutes`."""
    number = f"{minutes:.0f}" if minutes >= 9.95 else f"{minutes:.2g}"
    return f"{number} minute{'s' * (number != '1')}"
