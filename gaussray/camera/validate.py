"""Checks of parameter values on the host, with messages of one form."""

from collections.abc import Callable
from typing import Any

import numpy as np
from jax.core import Tracer


def require(
    key: str, value: Any, holds: Callable[[np.ndarray], Any], rule: str, remedy: str = ""
) -> None:
    """Raise `<key> must be <rule>, got <value>.` unless `holds` for every element.

    Inside `jit`, `vmap` or `grad` the value is not known and nothing is checked: build cameras on
    the host.
    """
    if isinstance(value, Tracer):
        return
    array = np.asarray(value)
    if not np.all(holds(array)):
        raise ValueError(f"{key} must be {rule}, got {array.tolist()}. {remedy}".rstrip())


def known(*values: Any) -> bool:
    """Whether all values are numbers rather than traced placeholders."""
    return not any(isinstance(value, Tracer) for value in values)
