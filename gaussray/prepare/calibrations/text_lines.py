"""Lines of words and numbers, as text and .csv files of cameras have them."""

import re
from pathlib import Path

import numpy as np

from gaussray.io.safe.files import read_text


# Lines that are not empty, with their numbers in the file.
NumberedLines = list[tuple[int, list[str]]]


def numbered_lines(path: Path) -> NumberedLines:
    """The lines of a file that are not empty, in words.

    Words end at gaps, commas, semicolons and brackets. Between commas, what is not all numbers is
    one word with its gaps: a name in a .csv.
    """
    text = read_text(path).decode("utf-8-sig", "replace")
    lines = ((number, _words(line)) for number, line in enumerate(text.splitlines(), 1))
    return [(number, words) for number, words in lines if words]


def line_numbers(words: list[str]) -> list[float] | None:
    """The numbers that words are; None if one is none, or not finite."""
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        return None
    return numbers if np.isfinite(numbers).all() else None


def _words(line: str) -> list[str]:
    cells = [cell.strip(" \t\"'") for cell in re.split(r"[,;\[\]]", line)]
    if len(cells) == 1:
        return cells[0].split()
    words: list[str] = []
    for cell in filter(None, cells):
        parts = cell.split()
        words += parts if line_numbers(parts) is not None else [" ".join(parts)]
    return words
