"""Which pictures of several folders were taken at one time, by the numbers in their names."""

import itertools
import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple


# Numbers that all folders have are times if they are so large a share of the pictures of the
# smallest folder, and of its pictures from the last of the first numbers to the first of the last.
_SHARE, _SHARE_WITHIN = 1 / 3, 1 / 2
# Fewest numbers that all folders have.
_LEAST = 2
# The varying numbers in the name of a picture.
_Key = tuple[int, ...]
# What two programs that write the frames of one video call the first of them.
_FIRSTS = {(0,), (1,)}


class FrameNumbers(NamedTuple):
    """How the pictures of several folders belong together.

    Args:
        common: the times that all folders have, in ascending order, if pictures of one number
            belong together and some folder lacks one; empty if pictures at one place in the order
            of the names do.
        times: the time of each picture of each folder, if `common` is not empty: its place among
            the numbers of all folders, each counted once.
        doubt: two pictures at one place whose numbers differ; empty if there are none.
        from_zero_and_one: whether a folder begins with 0 and another with 1: pictures at one place
            may belong together even if `common` is not empty.
    """

    common: list[int] = []
    times: dict[str, list[int]] = {}
    doubt: str = ""
    from_zero_and_one: bool = False

    def places(self, name: str) -> list[int]:
        """For each common time the place of its picture in a folder.

        Args:
            name: the folder.
        """
        place = {time: k for k, time in enumerate(self.times[name])}
        return [place[time] for time in self.common]

    @property
    def open_question(self) -> tuple[str, str]:
        """What is doubtful about which pictures belong together, and what to do if it is wrong;
        empty texts if nothing is."""
        if not self.doubt or (self.common and not self.from_zero_and_one):
            return "", ""
        if self.common:
            return (
                "pictures of one number are taken to be of one time, but pictures at one place may "
                f"be, as one folder begins with 0 and another with 1: {self.doubt}",
                "If they are, number the pictures of all folders from the same number on.",
            )
        return (
            "pictures at one place in their folders are taken to be of one time, but by the "
            f"numbers in their names they may not be: {self.doubt}",
            "If they are not, give pictures of one time the same name in all folders, and take "
            "away those that another folder lacks.",
        )


def frame_numbers(folders: Mapping[str, Sequence[Path]]) -> FrameNumbers:
    """How the pictures of several folders belong together.

    The number of a picture is the one in its name that differs between the pictures of a folder;
    of several ones, all must agree. Pictures of one number belong together where many of the
    numbers are in all folders. Folders of which one counts from 0 and another from 1, or whose
    numbers differ by a constant alone, may show the same times: pictures at one place belong
    together then.

    Args:
        folders: the pictures of each folder in natural order.
    """
    keys = _keys(folders)
    widths = {len(key) for own in keys.values() for key in own}
    alone = len(keys) < 2 or max(map(len, keys.values())) < _LEAST
    if alone or not all(keys.values()) or len(widths) != 1 or widths == {0}:
        return FrameNumbers()
    doubt = _doubt(folders, keys)
    increasing = all(a < b for own in keys.values() for a, b in itertools.pairwise(own))
    if not increasing or _may_count_alike(keys.values()):
        return FrameNumbers(doubt=doubt)
    place = {key: k for k, key in enumerate(sorted({key for own in keys.values() for key in own}))}
    times = {name: [place[key] for key in own] for name, own in keys.items()}
    common = sorted(set.intersection(*map(set, times.values())))
    if not _are_enough(common, list(times.values())):
        return FrameNumbers(doubt=doubt)
    if len(common) == len(place):
        # Names that are the same in all folders say no more than their order.
        return FrameNumbers()
    from_zero_and_one = {own[0] for own in keys.values()} == _FIRSTS
    return FrameNumbers(common, times, doubt, from_zero_and_one)


def evenly_numbered(pictures: Sequence[Path]) -> bool:
    """Whether names are alike but for one number, which grows by the same step from each picture to
    the next, as programs name the frames of a video.

    Args:
        pictures: the pictures of a folder in natural order.
    """
    if len(pictures) < _LEAST or len({re.sub(r"\d+", "0", path.stem) for path in pictures}) > 1:
        return False
    keys = _keys({"": pictures}).get("", [])
    steps = {later[0] - key[0] for key, later in itertools.pairwise(keys) if len(key) == 1}
    return len(steps) == 1 and min(steps) > 0 and len(keys[0]) == 1


def _keys(folders: Mapping[str, Sequence[Path]]) -> dict[str, list[_Key]]:
    """The numbers in the names of each folder's pictures that are not the same in all pictures of
    a folder; the last one if all are. Nothing where the names of a folder do not have as many
    numbers."""
    found = {
        name: [[int(part) for part in re.findall(r"\d+", path.stem)] for path in pictures]
        for name, pictures in folders.items()
    }
    if any(len({len(row) for row in rows}) > 1 for rows in found.values()):
        return {}
    varying = {
        name: {k for k, column in enumerate(zip(*rows, strict=True)) if len(set(column)) > 1}
        for name, rows in found.items()
    }
    if len({len(row) for rows in found.values() for row in rows}) == 1:
        # A folder may have too few pictures to show all that varies.
        varying = dict.fromkeys(found, set().union(*varying.values()))
    return {
        name: [tuple(row[k] for k in sorted(varying[name])) or tuple(row[-1:]) for row in rows]
        for name, rows in found.items()
    }


def _may_count_alike(keys: Collection[Sequence[_Key]]) -> bool:
    """Whether the numbers of all folders are the same but for where they begin."""
    firsts = {own[0] for own in keys}
    if len(firsts) == 1:
        return False
    counted = {
        tuple(tuple(n - first for n, first in zip(key, own[0], strict=True)) for key in own)
        for own in keys
    }
    consecutive = all(own[-1][0] - own[0][0] == len(own) - 1 for own in keys)
    return len(counted) == 1 or (consecutive and firsts == _FIRSTS)


def _are_enough(common: Sequence[int], numbers: Sequence[Sequence[int]]) -> bool:
    """Whether so many numbers are in all folders that this is no chance."""
    first, last = max(own[0] for own in numbers), min(own[-1] for own in numbers)
    within = min(sum(first <= number <= last for number in own) for own in numbers)
    fewest = max(_LEAST, _SHARE * min(map(len, numbers)), _SHARE_WITHIN * within)
    return len(common) >= fewest


def _doubt(folders: Mapping[str, Sequence[Path]], keys: Mapping[str, Sequence[_Key]]) -> str:
    """The first place at which two folders have pictures of different numbers."""
    one = next(iter(folders))
    for k in range(min(map(len, keys.values()))):
        a = folders[one][k].stem
        for name in folders:
            b = folders[name][k].stem
            if a != b and keys[name][k] != keys[one][k]:
                where = f"{one} begins with {a} and {name} with {b}"
                return where if not k else f"at place {k + 1} {one} has {a} and {name} {b}"
    return ""
