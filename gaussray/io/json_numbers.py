"""Writes arrays as JSON numbers that read back bit for bit."""

from typing import Any

import numpy as np


def json_numbers(value: Any) -> Any:
    """A number or an array as Python floats and nested lists.

    Each float is the shortest decimal that gives the same bits in the dtype of `value`; -0 becomes
    0."""
    array = np.asarray(value)
    return [json_numbers(v) for v in array] if array.ndim else float(str(array[()])) + 0.0
