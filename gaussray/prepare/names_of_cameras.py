"""Which camera each picture of one folder is of, where the names of the files say it."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple


# What names a camera in the name of a picture: `cam_0`, `camera1`, `cam-b`, `left`. Phones call
# their pictures `CAM00001`, and other programs by dates: longer numbers are of pictures.
_CAMERA = re.compile(
    r"(?<![a-z])(?:(?:cam|camera|gopro|kinect)[ _.-]?(?:\d{1,3}|[a-z])(?![a-z0-9])"
    r"|(?:left|right)(?![a-z]))",
    re.IGNORECASE,
)
# Words beside which `left` and `right` are cameras. In `house_left_07` they may be sides of it.
_PLAIN_WORDS = re.compile(r"left|right|image|img|im|frame|rgb|colou?r|camera|cam", re.IGNORECASE)
# Words that name a camera or a side of the thing that is shown.
_SIDE = re.compile(r"(?<![a-z])(?:front|back|rear|top|bottom|side|mid|middle)(?![a-z])", re.I)
# Share of the pictures that must have a camera, and a time that all cameras have.
_NEARLY_ALL = 0.8
# Fewest cameras, and fewest times.
_LEAST = 2


class NamedPictures(NamedTuple):
    """The pictures of a folder by the cameras that their names say.

    Args:
        cameras: for each camera its pictures; all cameras have the same times, if `together`.
        together: nearly all pictures are at times that all cameras have. If not, the names say
            that there are several cameras, but not which pictures were taken at one time.
    """

    cameras: dict[str, list[Path]]
    together: bool


def camera_in_name(name: str) -> str:
    """The part of a picture's name that names its camera; empty if none does.

    Args:
        name: the name without suffix: that of `cam_0_img_0008` is `cam_0`.
    """
    return "_".join(_CAMERA.findall(name))


def pictures_by_camera(pictures: Sequence[Path]) -> NamedPictures | None:
    """The pictures of one folder by camera: those whose names are alike but for the camera, as
    `cam_0_img_0008.jpg` and `cam_1_img_0008.jpg`, are of one time.

    None where the names do not say at least two cameras with two pictures each.

    Args:
        pictures: the files in the order of their times.
    """
    found = _grouped(pictures, _CAMERA)
    if found is not None and _together(found, len(pictures)) and not _may_be_sides(found):
        times = _common_times(found)
        cameras = {name: [own[time] for time in own if time in times]
                   for name, own in found.items()}  # fmt: skip
        return NamedPictures(cameras, True)
    if found is None:
        found = _grouped(pictures, _SIDE)
        # These words mean other things as well: their times must agree, too.
        if found is None or not _together(found, len(pictures)):
            return None
    return NamedPictures({name: list(own.values()) for name, own in found.items()}, False)


def _grouped(
    pictures: Sequence[Path], pattern: re.Pattern[str]
) -> dict[str, dict[str, Path]] | None:
    """For each camera its pictures by what else their names say; None without several cameras."""
    found: dict[str, dict[str, Path]] = {}
    for path in pictures:
        camera, time = "_".join(pattern.findall(path.stem)), pattern.sub("*", path.stem).lower()
        if camera and re.search(r"\d", time):
            found.setdefault(camera, {})[time] = path
    count = sum(len(own) for own in found.values())
    few = len(found) < _LEAST or min(len(own) for own in found.values()) < _LEAST
    return None if few or count < _NEARLY_ALL * len(pictures) else found


def _may_be_sides(found: dict[str, dict[str, Path]]) -> bool:
    """Whether `left` and `right` may be sides of what the other words of the names say."""
    names = [path.stem for own in found.values() for path in own.values()]
    others = any(re.search("[a-z]", _PLAIN_WORDS.sub("", name), re.IGNORECASE) for name in names)
    return others and {name.lower() for name in found} <= {"left", "right"}


def _common_times(found: dict[str, dict[str, Path]]) -> set[str]:
    return set.intersection(*(set(own) for own in found.values()))


def _together(found: dict[str, dict[str, Path]], count: int) -> bool:
    """Whether all cameras share times, and nearly all of `count` pictures are of these."""
    times = _common_times(found)
    return len(times) >= _LEAST and len(times) * len(found) >= _NEARLY_ALL * count
