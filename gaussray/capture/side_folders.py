"""Folders and files beside pictures that hold something else: depth maps, masks, calibrations."""

import re
from collections.abc import Sequence
from pathlib import Path


_MAPS = r"(?:depth|disparity|mask|segmentation|semantic|label|confidence|normal)s?|seg"
# Words that mean other things as well, where more follows.
_WHOLE = r"instances?|disp"
_BOARDS = (
    r"(?:calibration|calib|chess_?board|checker_?board|charuco|(?:in|ex)trinsic)s?"
    r"(?:[ _-]?\d+|[ _-](?:image|picture)s?)?"
)
_FOLDER = re.compile(rf"(?!normal(?!s))(?:{_MAPS})(?:[ _-].*)?|{_WHOLE}|{_BOARDS}", re.IGNORECASE)
_WORD = re.compile(rf"(?<![a-z])(?:{_MAPS}|{_WHOLE})(?![a-z])")
# Words in the name of a picture that its depth map has none of, or another one instead.
_PICTURE_WORD = re.compile(
    r"(?<![a-z])(?:colou?r|rgba?|image|img|im|photo|picture|frame)s?(?![a-z])"
)


def holds_other_maps(folder: Path) -> bool:
    """Whether the name of a folder says that it holds depth maps, masks, labels or normals, or
    pictures for a calibration.

    Args:
        folder: a folder beside one of pictures.
    """
    return _FOLDER.fullmatch(folder.name) is not None


def are_other_maps(pictures: Sequence[Path]) -> list[bool]:
    """Whether each file is a depth map, a mask or the like of another one.

    It is one if its name is that of the other plus a word between separators: `7_mask.png` beside
    `7.jpg`. In the other's name there may be a word for a picture instead: `7.depth.png` beside
    `7.color.jpg`.

    Args:
        pictures: the files of one folder.
    """
    names = [path.stem.lower() for path in pictures]
    others = {rest for name in names for rest in (_plain(name), *_without(_PICTURE_WORD, name))}
    return [not others.isdisjoint(_without(_WORD, name)) for name in names]


def _without(word: re.Pattern[str], name: str) -> set[str]:
    """What is left of a name without one of the words in it, and without all of them; nothing if it
    has none."""
    found = list(word.finditer(name))
    rests = [name[: one.start()] + " " + name[one.end() :] for one in found]
    return {_plain(rest) for rest in (*rests, *([word.sub(" ", name)] if found else []))}


def _plain(name: str) -> str:
    """A name with one kind of separator, and none at its ends."""
    return re.sub(r"[ ._-]+", " ", name).strip()
