"""The coefficients of distortion among the values of a camera."""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from gaussray.prepare.calibrations.opencv_numbers import (
    DISTORTION_COUNTS,
    agreed_numbers,
    plain_value,
)
from gaussray.prepare.calibrations.value_names import VALUE_NAMES, plain_key
from gaussray.prepare.errors import PrepareError


# Keys of distortion that is not one list of OpenCV's coefficients.
_APART = re.compile(r"k[1-6]|p[12]|radial.*|tangential.*|.*coef.*")
# Two numbers are k1 and k2. Three may be k1 k2 p1 or k1 k2 k3.
_COUNTS = (2, *DISTORTION_COUNTS)


def distortions_in(values: Mapping[str, Any]) -> dict[str, Any]:
    """The values that say the distortion of a lens, as one list or apart (`k1`, `radial`).

    Args:
        values: values by key.
    """
    return {key: value for key, value in values.items() if _is_listed(key) or _is_apart(key)}


def common_distortions(values: Mapping[str, Any]) -> dict[str, Any]:
    """The values beside cameras that say the distortion of all their lenses. A block that has a
    value for each camera, or is a camera, is none.

    Args:
        values: values by key.
    """
    plain = {key: plain_value(value) for key, value in distortions_in(values).items()}
    return {
        key: value
        for key, value in plain.items()
        if value is not None
        and not isinstance(value, Mapping)
        and (_is_listed(key) or (not isinstance(value, str) and _is_not_zero(value)))
    }


def distortion_in(where: str, values: Mapping[str, Any]) -> Float[np.ndarray, " n"]:
    """OpenCV's coefficients among the values of a camera; empty if it has none.

    Args:
        where: the file, and the camera in it, for messages.
        values: values by key.

    Raises:
        PrepareError: They are no such numbers, two keys differ, or they are not one list.
    """
    listed = {
        key: value
        for key, value in values.items()
        # Zeros are no distortion, however many there are.
        if _is_listed(key)
        and (_is_not_zero(plain_value(value)) or np.size(plain_value(value)) in _COUNTS)
    }
    found = agreed_numbers(where, listed, "distortion", _COUNTS)
    apart = [key for key in values if _is_apart(key) and _is_not_zero(values[key])]
    if apart and not len(found):
        raise PrepareError(
            f"{where}: distortion must be one list of OpenCV's coefficients (dist: [k1, k2, p1, "
            f"p2]), got {', '.join(map(str, apart))}. Write it so, with zeros for what is missing."
        )
    return found


def _is_listed(key: object) -> bool:
    return plain_key(key) in VALUE_NAMES["distortion"]


def _is_apart(key: object) -> bool:
    return not _is_listed(key) and _APART.fullmatch(plain_key(key)) is not None


def _is_not_zero(value: Any) -> bool:
    """Whether a value is anything else than zeros, false or nothing."""
    if value is None or (isinstance(value, str | Mapping) and not value):
        return False
    try:
        return bool(np.any(np.array(value, np.float64)))
    except (ValueError, TypeError, OverflowError):
        return True
