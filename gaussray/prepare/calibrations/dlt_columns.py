"""Tables of the coefficients of direct linear transforms (DLT): a camera in each column or line."""

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from gaussray.prepare.calibrations.projections import dlt_projection, focal_lengths
from gaussray.prepare.calibrations.text_lines import NumberedLines, line_numbers
from gaussray.prepare.errors import PrepareError


# Coefficients of a direct linear transform: a projection's numbers but the last, which is 1.
DLT_COUNT = 11
# Numbers of a whole projection in one line.
FLAT_COUNTS = (DLT_COUNT, 12)
# Names of coefficients: L1 to L11, and others, from 1 or 0 or by row and column.
_COEFFICIENT = re.compile(r"(l|p|m|n|dlt|coef[a-z]*)[ _-]?(\d+)", re.I)
_BY_ROW = [10 * row + column for row in (1, 2, 3) for column in (1, 2, 3, 4)]
# Other columns of 11 numbers, as times, make focal lengths of a few pixels at most.
_FOCAL = 10.0


class DltColumns(NamedTuple):
    """The coefficients of a camera in each column, and the names above them, if there are any."""

    names: list[str] | None
    coefficients: Float[np.ndarray, "cameras 11"]


def dlt_columns(lines: NumberedLines) -> DltColumns | None:
    """The cameras of 11 lines with a coefficient of each camera; None if they are none.

    A line above them may have a name for each column, and L1 to L11 may stand before the numbers.
    The name of a single column does not count: the file is one camera's.

    Args:
        lines: all of the file (`numbered_lines`).
    """
    if len(lines) not in (DLT_COUNT, DLT_COUNT + 1):
        return None
    head = lines[0][1] if len(lines) > DLT_COUNT else None
    rows = [words for _, words in lines[-DLT_COUNT:]]
    labelled = _are_coefficients([words[0] for words in rows])
    if labelled:
        rows = [words[1:] for words in rows]
        head = head[1:] if head and len(head) > len(rows[0]) else head
    width = len(rows[0])
    if not width or any(len(words) != width for words in rows):
        return None
    if head is None and not labelled and width in FLAT_COUNTS:
        return None  # as many numbers in a line may be a camera's: `refuse_square_table`
    if head is not None and (
        len(head) != width or line_numbers(head) is not None or _coefficients_in(head)
    ):
        return None
    numbers = [line_numbers(words) for words in rows]
    if any(one is None for one in numbers):
        return None
    columns = np.array(numbers).T
    if not any(min(focal_lengths(dlt_projection(column))) >= _FOCAL for column in columns):
        return None
    return DltColumns(head if width > 1 else None, columns)


def refuse_square_table(path: Path, lines: NumberedLines) -> None:
    """Refuse 11 lines of 11 or 12 numbers alone: cameras may be in lines or in columns.

    Args:
        path: the file, for messages.
        lines: all of the file.

    Raises:
        PrepareError: The lines are so.
    """
    width = len(lines[0][1]) if lines else 0
    if len(lines) != DLT_COUNT or width not in FLAT_COUNTS:
        return
    if all(len(words) == width and line_numbers(words) is not None for _, words in lines):
        raise PrepareError(
            f"{path}: 11 lines of {width} numbers must say whether a camera is a line or a column, "
            "got no names. Write the name of each camera before its line (cam1,0.1,...), or a line "
            "with the names above the columns (cam1,cam2,...)."
        )


def names_apart(lines: NumberedLines) -> NumberedLines:
    """Lines with a name and a projection, or a DLT, as two: the name and the numbers. A header with
    the names of the numbers (L1,L2,...) is left out; where the lines below have one word more, that
    is the name, and may be a number.

    Args:
        lines: all of the file.
    """
    count = _coefficients_in(lines[0][1]) if lines else 0
    result: NumberedLines = []
    for number, words in lines[1:] if count else lines:
        rest = line_numbers(words[1:])
        named = len(words) == count + 1 if count else line_numbers(words[:1]) is None
        if named and rest is not None and len(rest) in FLAT_COUNTS:
            result += [(number, words[:1]), (number, words[1:])]
        else:
            result.append((number, words))
    return result


def _coefficients_in(words: list[str]) -> int:
    """How many coefficients a header names, perhaps behind one other word; 0 if it is none."""
    for count in (12, DLT_COUNT):
        if len(words) - count in (0, 1) and _are_coefficients(words[-count:]):
            return count
    return 0


def _are_coefficients(words: list[str]) -> bool:
    """Whether words are the names of all coefficients in their order."""
    found = [match for word in words if (match := _COEFFICIENT.fullmatch(word))]
    if len(found) != len(words) or len({match[1].lower() for match in found}) > 1:
        return False
    numbers, count = [int(match[2]) for match in found], len(words)
    orders = (list(range(1, count + 1)), list(range(count)), _BY_ROW[:count])
    return count in FLAT_COUNTS and numbers in orders
