"""Folders and files beside pictures that hold something else: depth maps, masks, calibrations."""

import re
from pathlib import Path


_MAPS = (
    r"(?:depth|disparity|mask|segmentation|semantic|instance|label|confidence|normal)s?|disp|seg"
)
_BOARDS = r"calibrations?|calib|chess_?boards?|checker_?boards?|charuco|(?:in|ex)trinsics?"
_FOLDER = re.compile(rf"(?!normal(?!s))(?:{_MAPS}|{_BOARDS})([ _-].*)?", re.IGNORECASE)
_WORD = re.compile(rf"(?<![a-z])(?:{_MAPS})(?![a-z])", re.IGNORECASE)


def holds_other_maps(folder: Path) -> bool:
    """Whether the name of a folder says that it holds depth maps, masks, labels or normals, or
    pictures for a calibration.

    Args:
        folder: a folder beside one of pictures.
    """
    return _FOLDER.fullmatch(folder.name) is not None


def word_of_other_map(picture: Path) -> str:
    """The word in a picture's name, between separators, by which it is a depth map, a mask or the
    like, in small letters: that of `frame-07.depth.png` is `depth`. Empty if there is none.

    Args:
        picture: a file beside others.
    """
    found = _WORD.search(picture.stem)
    return found.group().lower() if found else ""
