"""Numbers of JSON files that are read back bit by bit."""

from typing import Any

import numpy as np


def json_numbers(value: Any) -> Any:
    """A number or an array as Python floats and lists, each float the shortest decimal that gives
    back the same bits in the dtype of `value`; -0 becomes 0."""
    array = np.asarray(value)
    return [json_numbers(v) for v in array] if array.ndim else float(str(array[()])) + 0.0
