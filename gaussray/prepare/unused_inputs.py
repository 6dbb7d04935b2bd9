"""What of an input folder is not used, and what is told of it."""

import re
from collections.abc import Sequence
from pathlib import Path

from gaussray.capture.side_folders import holds_other_maps
from gaussray.capture.videos import VIDEO_SUFFIXES
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.input_files import MEDIA_SUFFIXES, files_in, warn_of_input
from gaussray.prepare.photographs import PHOTOGRAPH_SUFFIXES
from gaussray.runtime.output import counted, first_of
from gaussray.runtime.progress import say


# What a mask may have behind the name of its picture or video: a_mask.png, a.mask.png.
MASK_MARK = re.compile(r"[ ._-]masks?$")


def camera_videos(folder: Path) -> list[Path]:
    """The videos of a folder without those of masks: `cam0_mask.mp4` beside `cam0.mp4`.

    Args:
        folder: an existing folder.
    """
    videos = files_in(folder, VIDEO_SUFFIXES)
    stems = {path.stem.lower() for path in videos}
    plain = {path: MASK_MARK.sub("", path.stem.lower()) for path in videos}
    return [
        path
        for path in videos
        if plain[path] in ("", path.stem.lower()) or plain[path] not in stems
    ]


def without_fewer(folder: Path, beside: list[Path], inside: list[Path]) -> list[Path]:
    """The subfolders, or none with a warning if they hold fewer pictures than lie beside them.

    Args:
        folder: the folder of the input.
        beside: pictures in it.
        inside: its subfolders.
    """
    held = [path for path in inside if files_in(path, MEDIA_SUFFIXES)]
    count = sum(len(files_in(path, PHOTOGRAPH_SUFFIXES)) for path in held)
    if not held or len(beside) <= count or any(files_in(path, VIDEO_SUFFIXES) for path in held):
        return inside
    folders = first_of([path.name for path in held])
    warn_of_input(
        f"videos={folder}: the {len(beside)} pictures in this folder are used, and not the {count} "
        f"in its folder{'s' * (len(held) != 1)} {folders}. If those are meant, name their folder; "
        "if both are, move the others into a folder of their own."
    )
    return []


def warn_of_unused(folder: Path, beside: list[Path], names: list[str]) -> None:
    """Warn of pictures beside the cameras' videos and folders.

    Args:
        folder: the folder of the input.
        beside: pictures in it.
        names: names of the cameras.
    """
    one = len(beside) == 1
    warn_of_input(
        f"videos={folder}: {counted(len(beside), 'picture')} beside "
        f"{counted(len(names), 'camera')} ({first_of(names)}) {'is' if one else 'are'} not used. "
        f"If {'it is' if one else 'they are'} meant, move {'it' if one else 'them'} into a folder "
        "of their own."
    )


def tell_deeper(folder: Path, inside: Sequence[Path]) -> None:
    """Say which subfolders are no cameras, because they hold pictures or videos in folders of
    their own alone.

    Args:
        folder: the folder of the input.
        inside: its subfolders that may be cameras.
    """
    empty = [path for path in inside if not files_in(path, MEDIA_SUFFIXES)]
    shown = [path for path in empty if not path.name.startswith(".") and not holds_other_maps(path)]
    deeper = [path for path in shown if _holds_deeper(path)]
    if not deeper:
        return
    one = len(deeper) == 1
    say(
        f"videos={folder}: {counted(len(deeper), 'folder')} "
        f"({first_of([path.name for path in deeper])}) {'is' if one else 'are'} not used, because "
        f"{'its' if one else 'their'} pictures and videos lie in folders further down. If "
        f"{'it is' if one else 'they are'} meant: videos={deeper[0]}."
    )


def _holds_deeper(folder: Path) -> bool:
    """Whether a picture or video lies in a folder of a folder, or one further down."""
    places = (path for pattern in ("*", "*/*") for path in folder.glob(pattern) if path.is_dir())
    return any(files_in(path, MEDIA_SUFFIXES) for path in places)


def check_one_video(inside: Sequence[Path]) -> None:
    """Refuse folders of cameras of which one holds several videos.

    Args:
        inside: the folders.

    Raises:
        PrepareError: One does; the message lists the videos and the choice.
    """
    names = {path: [p.name for p in camera_videos(path)] for path in inside}
    names = {path: own for path, own in names.items() if own}
    several = next((path for path, own in names.items() if len(own) > 1), None)
    if several is None:
        return
    common = [name for name in names[several] if all(name in own for own in names.values())]
    if len(names) == 1:
        remedy = f"If each is a camera, set videos={several}; else leave one of them there"
    elif common:
        choice = " or ".join(filter(None, [", ".join(common[:-1]), common[-1]]))
        remedy = f"Leave {choice} alone in each folder, whichever shows the scene"
    else:
        remedy = "Leave one of them, that shows the scene, in each folder"
    raise PrepareError(
        f"{several}: the folder of a camera must hold one video, got {', '.join(names[several])}. "
        f"{remedy}, and move the others out of the input."
    )
