"""The place from which the positions of a capture are counted while it is read."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import numpy as np


# A coordinate from which on positions are those of a map: numbers of 32 bits are a thousandth of a
# unit apart there, or more.
MAP_COORDINATE = 1e4
_origin: ContextVar[np.ndarray | None] = ContextVar("origin", default=None)


def counted_positions(position: np.ndarray) -> np.ndarray:
    """Positions of a file, (..., 3), counted from the origin in force (`counted_from`)."""
    origin = _origin.get()
    return position if origin is None else np.asarray(position, np.float64) - origin


@contextmanager
def counted_from(origin: np.ndarray) -> Iterator[None]:
    """Positions that are read meanwhile are counted from this place, in the file's world."""
    token = _origin.set(origin)
    try:
        yield
    finally:
        _origin.reset(token)
