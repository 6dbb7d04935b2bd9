"""Text on stdout and stderr, whose reader may have gone."""

import os
from collections.abc import Sequence
from typing import Any


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


def counted(count: int, noun: str) -> str:
    """A number and what it counts: `1 picture`, `2,000 pictures`.

    Args:
        count: the number.
        noun: what one of them is called.
    """
    return f"{count:,} {noun}{'s' * (count != 1)}"
