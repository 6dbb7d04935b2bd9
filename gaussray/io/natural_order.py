"""Sorting of files by the numbers in their names."""

import re
from pathlib import Path


def natural_order(path: Path) -> list[tuple[int, str]]:
    """A key that sorts names by the numbers in them, whatever the case: cam2 before Cam10.

    Args:
        path: a file or folder, of which the name counts.
    """
    parts = re.split(r"(\d+)", path.name.lower())
    return [(int(part), "") if k % 2 else (-1, part) for k, part in enumerate(parts)]
