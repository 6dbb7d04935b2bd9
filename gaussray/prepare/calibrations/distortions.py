"""The coefficients of distortion among the values of a camera."""

import decimal
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from gaussray.prepare.calibrations.lens_labels import is_fisheye, labels_in
from gaussray.prepare.calibrations.opencv_numbers import (
    DISTORTION_COUNTS,
    agreed_numbers,
    finite_numbers,
    plain_value,
)
from gaussray.prepare.calibrations.value_names import VALUE_NAMES, plain_key
from gaussray.prepare.errors import PrepareError


# OpenCV's distortion coefficients in their order, and those of its fisheye.
OPENCV_ORDER = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_FISHEYE_ORDER = OPENCV_ORDER[:2] + OPENCV_ORDER[4:6]
# Keys of distortion that is not one list of OpenCV's coefficients.
_APART = re.compile(r"k[1-6]|p[12]|radial.*|tangential.*|.*coef.*")
# One number is k1, two are k1 and k2. Others may be several things.
_COUNTS = (1, 2, *DISTORTION_COUNTS)
_UNCLEAR = {
    3: "k1 k2 k3 (write [k1, k2, 0, 0, k3]) or k1 k2 p1 (write [k1, k2, p1, 0])",
    6: "k1 to k6 (write [k1, k2, 0, 0, k3, k4, k5, k6]) or k1 k2 p1 p2 k3 k4 (write them with 0, 0 "
    "behind)",
}


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

    They are one list, or have a key each (`k1`). Beside a list a key may say the same with fewer
    digits, and others are not read (`overruled_coefficients`).

    Args:
        where: the file, and the camera in it, for messages.
        values: values by key.

    Raises:
        PrepareError: They are no such numbers, there are three or six, or two keys differ.
    """
    listed = {
        key: value
        for key, value in values.items()
        # Zeros are no distortion, however many there are.
        if _is_listed(key)
        and (_is_not_zero(plain_value(value)) or _size(plain_value(value)) in _COUNTS)
    }
    _refuse_unclear(where, listed)
    found = agreed_numbers(where, listed, "distortion", _COUNTS)
    apart = _apart(values)
    if not apart:
        return found
    if not len(found):
        return _in_order(where, values, apart)
    said = _by_name(where, values, found)
    for key, value in apart.items():
        if plain_key(key) in OPENCV_ORDER and not _is_rounded(value, said.get(plain_key(key), 0.0)):
            raise PrepareError(
                f"{where}: {key} must not differ from the listed coefficients {found.tolist()}, "
                f"got {str(value)[:80]}. Keep one of them."
            )
    return found


def overruled_coefficients(where: str, values: Mapping[str, Any]) -> list[str]:
    """The keys beside a list of coefficients that are not read: they say the same with fewer
    digits, or under names of others (`radial`).

    Args:
        where: the file, and the camera in it, for messages.
        values: values by key of a camera (`distortion_in`).
    """
    if not any(_is_listed(key) for key in values):
        return []
    found = distortion_in(where, {key: value for key, value in values.items() if _is_listed(key)})
    if not len(found):
        return []
    said = _by_name(where, values, found)
    return [key for key, value in _apart(values).items()
            if plain_key(key) not in said or said[plain_key(key)] != _as_number(value)]  # fmt: skip


def _apart(values: Mapping[str, Any]) -> dict[str, Any]:
    """The values of distortion that have a key each, but for zeros."""
    apart = {str(key): plain_value(value) for key, value in values.items() if _is_apart(key)}
    return {key: value for key, value in apart.items() if _is_not_zero(value)}


def _by_name(
    where: str, values: Mapping[str, Any], found: Float[np.ndarray, " n"]
) -> dict[str, float]:
    """The listed coefficients by their names."""
    order = _FISHEYE_ORDER if is_fisheye(where, values) else OPENCV_ORDER
    return dict(zip(order, found.tolist(), strict=False))


def _as_number(value: Any) -> float | None:
    """The number of a value; None if it is no single number."""
    try:
        return float(finite_numbers(value, (1,))[0])
    except ValueError:
        return None


def _is_rounded(value: Any, exact: float) -> bool:
    """Whether a value is a number, and one of both is the other one with fewer digits."""
    number = _as_number(value)
    if number is None:
        return False
    # A zero has no digits that could be rounded.
    if not number or not exact:
        return number == exact
    places = [decimal.Decimal(repr(x)).as_tuple().exponent for x in (number, exact)]
    return abs(number - exact) <= 0.5 * 10.0 ** max(map(int, places)) * (1 + 1e-9)


def _in_order(
    where: str, values: Mapping[str, Any], apart: Mapping[str, Any]
) -> Float[np.ndarray, " n"]:
    """The list of coefficients that have a key each.

    Args:
        where: the file, and the camera in it, for messages.
        values: all values of the camera.
        apart: those of distortion that are not 0.
    """
    named = {plain_key(key): key for key in apart}
    if unread := [key for name, key in named.items() if name not in OPENCV_ORDER]:
        raise PrepareError(
            f"{where}: distortion must be one list of OpenCV's coefficients (dist: [k1, k2, p1, "
            f"p2]) or k1, k2, p1, p2, k3 under these keys, got {', '.join(map(str, unread))}. "
            "Write it so, with zeros for what is missing."
        )
    fisheye = is_fisheye(where, values)
    keys = {plain_key(key) for key in values}
    if "k4" in named and not fisheye and not labels_in(values) and not keys & {"p1", "p2", "k5"}:
        raise PrepareError(
            f"{where}: k1, k2, k3 and k4 without p1 and p2 may be of OpenCV's fisheye or of its "
            "plain model. Add fisheye: true, or p1 and p2 (0 if there are none)."
        )
    order = _FISHEYE_ORDER if fisheye else OPENCV_ORDER
    if others := [key for name, key in named.items() if name not in order]:
        raise PrepareError(
            f"{where}: OpenCV's fisheye has k1 to k4, got {', '.join(map(str, others))}. Correct "
            "its model or its coefficients."
        )
    try:
        numbers = {name: float(finite_numbers(apart[key], (1,))[0]) for name, key in named.items()}
    except ValueError as error:
        raise PrepareError(
            f"{where}: {' and '.join(map(str, apart))} {error}. Write one number each."
        ) from None
    count = 4 if fisheye or not numbers.keys() & set(OPENCV_ORDER[4:]) else 5
    count = len(order) if numbers.keys() & set(OPENCV_ORDER[5:]) else count
    return np.array([numbers.get(name, 0.0) for name in order[:count]])


def _refuse_unclear(where: str, listed: Mapping[str, Any]) -> None:
    """Refuse a list of so many coefficients that it may mean several things."""
    for key, value in listed.items():
        if (count := _size(plain_value(value))) in _UNCLEAR:
            raise PrepareError(
                f"{where}: {key} must be OpenCV's 4, 5 or 8 coefficients (k1 k2 p1 p2 k3 ...), k1, "
                f"or k1 k2, got {count}, which may be {_UNCLEAR[count]}. Write them so."
            )


def _size(value: Any) -> int:
    """How many numbers a value has; unlike lists in a list count as they stand."""
    return int(np.size(np.array(value, object)))


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
