"""Which pictures of several folders were taken at one time, by the numbers in their names."""

import itertools
import re
import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple


# Numbers that all folders have are times if they are so large a share of the pictures of the
# smallest folder, and of its pictures from the last of the first numbers to the first of the last.
_SHARE, _SHARE_WITHIN = 1 / 3, 1 / 2
# Fewest numbers that all folders have.
_LEAST = 2
# What two programs that write the frames of one video call the first of them.
_FIRSTS = {0, 1}


class FrameNumbers(NamedTuple):
    """How the pictures of several folders belong together.

    Args:
        common: the numbers that all folders have, in ascending order, if pictures of one number
            belong together; empty if pictures at one place in the order of the names do.
        numbers: the number of each picture of each folder, if `common` is not empty.
        doubt: two pictures at one place whose numbers differ; empty if there are none.
    """

    common: list[int]
    numbers: dict[str, list[int]]
    doubt: str

    def places(self, name: str) -> list[int]:
        """For each common number the place of its picture in a folder.

        Args:
            name: the folder.
        """
        place = {number: k for k, number in enumerate(self.numbers[name])}
        return [place[number] for number in self.common]

    def counts(self, name: str) -> list[float]:
        """The times of a folder's pictures, in median steps between the common numbers, from the
        least number of all folders on.

        Args:
            name: the folder.
        """
        step = statistics.median(b - a for a, b in itertools.pairwise(self.common))
        least = min(own[0] for own in self.numbers.values())
        return [(number - least) / step for number in self.numbers[name]]

    @property
    def is_order(self) -> bool:
        """Whether pictures of one number are at one place in all folders, without a gap."""
        whole = all(len(own) == len(self.common) for own in self.numbers.values())
        return whole and len({b - a for a, b in itertools.pairwise(self.common)}) <= 1


def frame_numbers(folders: Mapping[str, Sequence[Path]]) -> FrameNumbers:
    """How the pictures of several folders belong together.

    The number of a picture is the one in its name that differs between the pictures of its folder.
    Pictures of one number belong together where many of the numbers are in all folders. Folders
    of which one counts from 0 and another from 1, or whose numbers differ by a constant alone, may
    show the same times: pictures at one place belong together then.

    Args:
        folders: the pictures of each folder in natural order.
    """
    keys = {name: _keys(pictures) for name, pictures in folders.items()}
    widths = {len(key) for own in keys.values() for key in own}
    alone = len(folders) < 2 or max(map(len, keys.values())) < _LEAST
    if alone or len(widths) != 1 or widths == {0}:
        return FrameNumbers([], {}, "")
    doubt = _doubt(folders, keys)
    numbers = {name: [key[0] for key in own] for name, own in keys.items()}
    increasing = all(a < b for own in numbers.values() for a, b in itertools.pairwise(own))
    if widths != {1} or not increasing or _may_count_alike(list(numbers.values())):
        return FrameNumbers([], {}, doubt)
    common = sorted(set.intersection(*map(set, numbers.values())))
    if not _are_enough(common, list(numbers.values())):
        return FrameNumbers([], {}, doubt)
    return FrameNumbers(common, numbers, doubt)


def _keys(pictures: Sequence[Path]) -> list[tuple[int, ...]]:
    """The numbers in the names of a folder's pictures that are not the same in all; the last one
    if all are. Nothing where the names do not have as many numbers."""
    found = [[int(part) for part in re.findall(r"\d+", path.stem)] for path in pictures]
    if len({len(row) for row in found}) != 1 or not found[0]:
        return [() for _ in found]
    columns = list(zip(*found, strict=True))
    varying = [column for column in columns if len(set(column)) > 1] or columns[-1:]
    return list(zip(*varying, strict=True))


def _may_count_alike(numbers: Sequence[Sequence[int]]) -> bool:
    """Whether the numbers of all folders are the same but for where they begin."""
    if len({own[0] for own in numbers}) == 1:
        return False
    if len({tuple(number - own[0] for number in own) for own in numbers}) == 1:
        return True
    consecutive = all(own[-1] - own[0] == len(own) - 1 for own in numbers)
    return consecutive and {own[0] for own in numbers} == _FIRSTS


def _are_enough(common: Sequence[int], numbers: Sequence[Sequence[int]]) -> bool:
    """Whether so many numbers are in all folders that this is no chance."""
    first, last = max(own[0] for own in numbers), min(own[-1] for own in numbers)
    within = min(sum(first <= number <= last for number in own) for own in numbers)
    fewest = max(_LEAST, _SHARE * min(map(len, numbers)), _SHARE_WITHIN * within)
    return len(common) >= fewest


def _doubt(
    folders: Mapping[str, Sequence[Path]], keys: Mapping[str, Sequence[tuple[int, ...]]]
) -> str:
    """The first place at which two folders have pictures of different numbers."""
    one = next(iter(folders))
    for k in range(min(map(len, keys.values()))):
        other = next((name for name in folders if keys[name][k] != keys[one][k]), None)
        if other is not None:
            a, b = folders[one][k].stem, folders[other][k].stem
            where = f"{one} begins with {a} and {other} with {b}"
            return where if not k else f"at place {k + 1} {one} has {a} and {other} {b}"
    return ""
