"""Text on stdout and stderr, whose reader may have gone."""

import os
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


def counted(count: int, noun: str) -> str:
    """A number and what it counts: `1 picture`, `2,000 pictures`.

    Args:
        count: the number.
        noun: what one of them is called.
    """
    return f"{count:,} {noun}{'s' * (count != 1)}"
