"""Checks of the numbers that calibrations around OpenCV hold under a key."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from gaussray.prepare.calibrations.value_names import VALUE_NAMES, plain_key
from gaussray.prepare.errors import PrepareError


# OpenCV's numbers of distortion coefficients.
DISTORTION_COUNTS = (4, 5, 8, 12, 14)
# A rotation times its transpose may differ from the identity by this, where text has few digits.
ORTHONORMAL = 1e-3


def finite_numbers(value: Any, counts: Sequence[int]) -> Float[np.ndarray, " n"]:
    """The numbers of a value of any shape, in reading order.

    Args:
        value: an array, a list or a number.
        counts: how many there may be.

    Raises:
        ValueError: There are others than these, or some are not finite. The message is to stand
            after the key: "must be 9 finite numbers, got 6".
    """
    wanted = f"must be {' or '.join(map(str, counts))} finite numbers"
    if tuple(counts) == (1,):
        wanted = "must be a finite number"
    if isinstance(value, bool | np.bool_):
        raise ValueError(f"{wanted}, got {value}")
    if isinstance(value, np.ndarray) and value.dtype.kind not in "fiu":
        raise ValueError(f"{wanted}, got values of type {value.dtype}")
    try:
        numbers = np.array(value, np.float64).ravel()
    except (ValueError, TypeError, OverflowError):
        raise ValueError(f"{wanted}, got {str(value)[:80]}") from None
    if len(numbers) not in counts:
        raise ValueError(f"{wanted}, got {len(numbers)}")
    if not np.isfinite(numbers).all():
        raise ValueError(f"{wanted}, got {numbers.tolist()}")
    return numbers


def numbers_under(
    values: Mapping[str, Any], names: Iterable[str], counts: tuple[int, ...]
) -> tuple[str, Float[np.ndarray, " n"]] | None:
    """The first key of some names that has so many finite numbers, and these; None if none has.

    Args:
        values: values by key.
        names: plain keys (`plain_key`).
        counts: how many numbers there may be.
    """
    for key, value in values.items():
        if plain_key(key) in names:
            try:
                return str(key), finite_numbers(plain_value(value), counts)
            except ValueError:
                continue
    return None


def agreed_numbers(
    where: str, values: Mapping[str, Any], what: str, counts: tuple[int, ...]
) -> Float[np.ndarray, " n"]:
    """The numbers under the keys of one meaning, of which those with other counts are another
    thing; empty if there are no keys, or nothing under them.

    Args:
        where: the file, and the camera in it, for messages.
        values: values by key.
        what: the meaning (`VALUE_NAMES`).
        counts: how many numbers there may be.

    Raises:
        PrepareError: No key has such numbers, or those of two keys differ.
    """
    found: dict[str, np.ndarray] = {}
    complaint = ""
    for key, given in values.items():
        value = plain_value(given)
        if plain_key(key) not in VALUE_NAMES[what] or _is_nothing(value):
            continue
        try:
            found[str(key)] = finite_numbers(value, counts)
        except ValueError as error:
            complaint = complaint or f"{where}: {key} {error}"
    if complaint and not found:
        raise PrepareError(f"{complaint}. Correct or remove it.")
    for key, numbers in found.items():
        first = next(iter(found))
        if not np.array_equal(numbers, found[first]):
            raise PrepareError(
                f"{where}: {first} and {key} must not differ, because both are the {what}. Keep "
                "one of them."
            )
    return next(iter(found.values()), np.zeros(0))


def plain_value(value: Any) -> Any:
    """A value, or the `data` of a block with `rows`, `cols` and `data`, as ROS, and OpenCV in JSON,
    write a matrix."""
    return value["data"] if isinstance(value, Mapping) and "data" in value else value


def _is_nothing(value: Any) -> bool:
    """Whether a value says nothing. A block is no numbers."""
    if isinstance(value, str):
        return value in ("", "null")
    if value is None or isinstance(value, bool | np.bool_ | Mapping):
        return not isinstance(value, bool | np.bool_) or not value
    return isinstance(value, list | np.ndarray) and not len(np.ravel(np.array(value, object)))


def checked_rotation(values: Float[np.ndarray, " 9"]) -> Float[np.ndarray, "3 3"]:
    """The rotation matrix of nine numbers, row by row.

    Raises:
        ValueError: They are no rotation, or one with a reflection. The message is to stand after
            the key.
    """
    matrix = values.reshape(3, 3)
    if np.abs(matrix @ matrix.T - np.eye(3)).max() > ORTHONORMAL:
        raise ValueError(
            f"must be a rotation (rows of length 1, at right angles), got {matrix.tolist()}"
        )
    if np.linalg.det(matrix) < 0:
        raise ValueError(f"must be a rotation without a reflection, got {matrix.tolist()}")
    return matrix
