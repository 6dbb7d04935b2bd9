"""Which of two videos is of the first camera of a stereo calibration, whose file says no names."""

import dataclasses
import re
from collections.abc import Sequence

from gaussray.prepare.calibrations.known_camera import Calibration
from gaussray.prepare.errors import PrepareError


# What the names of the first and of the second camera have in them. Numbers are their last ones.
_WORDS = (("left", "right"), ("l", "r"), ("a", "b"))
_NUMBERS = (("0", "1"), ("1", "2"))
# A side before or behind a noun that it is written together with.
_NOUN = "(?:cam|camera|img|image|imgs|images|video|view|eye|frame|frames|side)"
_SIDE_OF = re.compile(f"{_NOUN}*(left|right){_NOUN}*")
_RULE = "left and right, cam0 and cam1, or cam1 and cam2"


def names_in_order(names: Sequence[str]) -> tuple[str, str] | None:
    """Two names, that of the first (left) camera first; None if there are others than two, or they
    do not say which is which.

    Args:
        names: names of videos: left and right, L and R, a and b, 0 and 1, 1 and 2, alone or as a
            part of the name.
    """
    if len(names) != 2:
        return None
    for pairs, marks in ((_WORDS, _words), (_NUMBERS, _last_number)):
        for pair in pairs:
            found = [[mark for mark in pair if mark in marks(name)] for name in names]
            if found == [[pair[0]], [pair[1]]]:
                return names[0], names[1]
            if found == [[pair[1]], [pair[0]]]:
                return names[1], names[0]
    return None


def named_pair(calibration: Calibration, names: Sequence[str]) -> Calibration:
    """A stereo calibration with its cameras called as the two videos; any other is unchanged.

    Args:
        calibration: the cameras.
        names: names of the videos.
    """
    order = names_in_order(names)
    if not calibration.is_pair or order is None:
        return calibration
    renamed = [
        dataclasses.replace(camera, name=name)
        for camera, name in zip(calibration.cameras, order, strict=True)
    ]
    return dataclasses.replace(calibration, cameras=renamed)


def check_pair(calibration: Calibration, names: Sequence[str]) -> None:
    """Refuse videos that a stereo calibration's cameras cannot be given to.

    Args:
        calibration: the cameras; one that is no stereo calibration passes.
        names: names of the videos.

    Raises:
        PrepareError: There are more than two videos, or two whose names do not say which is of the
            first camera.
    """
    if not calibration.is_pair or len(names) < 2:
        return
    listed = ", ".join(names[:9])
    if len(names) > 2:
        raise PrepareError(
            f"poses.calibration is of two cameras, got {len(names)} videos or folders: {listed}. "
            "Take away those that are not of it, and call the two left and right."
        )
    if names_in_order(names) is None:
        raise PrepareError(
            "poses.calibration is of a first (left) and a second (right) camera without names, and "
            f"the videos' names must say which is which ({_RULE}), got {listed}. Rename them."
        )


def _words(name: str) -> set[str]:
    """The words of a name in small letters (`imgL`: img, l), and a side that is written together
    with what it is of (`leftcam`)."""
    words = {word.lower() for word in re.findall(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+", name)}
    return words | {match[1] for word in words if (match := _SIDE_OF.fullmatch(word))}


def _last_number(name: str) -> set[str]:
    digits = re.findall(r"\d+", name)
    return {str(int(digits[-1]))} if digits else set()
