"""The size of a camera's pictures among the values of a file."""

from collections.abc import Mapping
from typing import Any

from gaussray.prepare.calibrations.opencv_numbers import (
    agreed_numbers,
    finite_numbers,
    numbers_under,
)
from gaussray.prepare.calibrations.value_names import VALUE_NAMES, plain_key
from gaussray.prepare.errors import PrepareError


# Fewer columns or rows have no pictures of calibrations.
SMALLEST = 64
_SIDES = ("width", "height")


def sizes_in(values: Mapping[str, Any]) -> dict[str, Any]:
    """The values that say the size of a camera's pictures.

    Args:
        values: values by key.
    """
    names = {name for what in ("size", *_SIDES) for name in VALUE_NAMES[what]}
    return {key: value for key, value in values.items() if plain_key(key) in names}


def sides_in(values: Mapping[str, Any]) -> tuple[float, float]:
    """Columns and rows that have a key each, among the values or in a block of a size; 0 for what
    is not said.

    Args:
        values: values by key.
    """
    blocks = [value for value in sizes_in(values).values() if isinstance(value, Mapping)]
    sides = {key: value for block in [values, *blocks] for key, value in block.items()}
    columns, rows = (_first(sides, VALUE_NAMES[what]) for what in _SIDES)
    return columns, rows


def size_in(where: str, values: Mapping[str, Any]) -> tuple[float, float]:
    """Columns and rows of a camera's pictures; 0 if its values do not say them.

    Args:
        where: the file, and the camera in it, for messages.
        values: values by key.

    Raises:
        PrepareError: A size is said that is not of two numbers, or two keys of it differ.
    """
    given = {key: value for key, value in sizes_in(values).items() if not _is_empty(value)}
    columns, rows = sides_in(given)
    if not (columns and rows) or numbers_under(given, VALUE_NAMES["size"], (2,)) is not None:
        listed = agreed_numbers(where, given, "size", (2,))
        columns, rows = map(float, listed if len(listed) else (columns, rows))
    if given and not (columns and rows):
        raise PrepareError(
            f"{where}: the size must be two whole numbers (columns and rows), got "
            f"{str(given)[:80]}. Correct or remove it."
        )
    return columns, rows


def _is_empty(value: Any) -> bool:
    return value is None or (isinstance(value, str | list | Mapping) and not value)


def _first(values: Mapping[str, Any], names: tuple[str, ...]) -> float:
    for value in (value for key, value in values.items() if plain_key(key) in names):
        try:
            return float(finite_numbers(value, (1,))[0])
        except ValueError:
            continue
    return 0.0
