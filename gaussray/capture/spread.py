"""A few of many items, at even distances."""

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from jaxtyping import Int


_T = TypeVar("_T")


def spread_indices(length: int, count: int) -> Int[np.ndarray, " chosen"]:
    """At most so many indices of a sequence at even distances, the first and the last included.

    Args:
        length: length of the sequence.
        count: the largest number of indices; a single one is the first.
    """
    return np.linspace(0, length - 1, min(length, count)).round().astype(int)


def evenly_spread(items: Sequence[_T], count: int) -> list[_T]:
    """At most so many items at even distances, the first and the last included.

    Args:
        items: the items, in order.
        count: the largest number of them.
    """
    return [items[i] for i in spread_indices(len(items), count)]
