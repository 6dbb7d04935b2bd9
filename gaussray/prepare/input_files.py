"""Files and folders of an input that may be of cameras: without depth maps, masks, calibrations."""

import itertools
import warnings
from collections.abc import Collection
from pathlib import Path

from gaussray.capture.errors import CaptureWarning
from gaussray.capture.side_folders import are_other_maps, holds_other_maps
from gaussray.capture.videos import VIDEO_SUFFIXES
from gaussray.io.natural_order import natural_order
from gaussray.prepare.photographs import PHOTOGRAPH_SUFFIXES
from gaussray.runtime.output import first_of


MEDIA_SUFFIXES = (*VIDEO_SUFFIXES, *PHOTOGRAPH_SUFFIXES)
# Videos and photographs that are not read: raw formats, those of 360-degree cameras, animations.
_UNREAD = (
    *(".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2", ".gif", ".avif", ".jp2"),
    *(".insv", ".insp", ".360", ".wmv", ".flv", ".ts", ".vob"),
)
# Folders and files that a message names.
_NAMED = 3


def files_in(folder: Path, suffixes: Collection[str]) -> list[Path]:
    """The files of a folder with one of these suffixes, in natural order, without hidden ones.

    Args:
        folder: an existing folder.
        suffixes: suffixes in small letters, as `.png`.
    """
    hidden = (path for path in folder.iterdir() if not path.name.startswith("."))
    found = (path for path in hidden if path.suffix.lower() in suffixes and path.is_file())
    return sorted(found, key=natural_order)


def unread_files(folder: Path) -> list[Path]:
    """Files of other formats, but those of pictures that are read as well (raw beside JPEG)."""
    read = {path.stem for path in files_in(folder, MEDIA_SUFFIXES)}
    return [path for path in files_in(folder, _UNREAD) if path.stem not in read]


def camera_folders(folder: Path, *, alone: bool) -> list[Path]:
    """The folders in a folder without those of depth maps, masks and calibrations, with a warning;
    all of them, where there is nothing else that could be a camera.

    Args:
        folder: the folder of the input.
        alone: whether beside its folders is nothing that could be a camera.
    """
    folders = sorted((p for p in folder.iterdir() if p.is_dir()), key=natural_order)
    held = [path for path in folders if files_in(path, MEDIA_SUFFIXES)]
    other = [path for path in held if holds_other_maps(path)]
    if not other or (alone and len(other) == len(held)):
        return folders
    warn_of_input(
        f"videos={folder}: {_listed(other)}: by the name no pictures of a camera (masks that are "
        "named as the pictures count as masks). Rename what is a camera."
    )
    return [path for path in folders if path not in other]


def photographs_in(folder: Path) -> list[Path]:
    """The photographs in a folder, without the depth maps, masks and the like beside them, with a
    warning.

    Their names tell them: `frame-07.depth.png` beside `frame-07.color.jpg` (`are_other_maps`).

    Args:
        folder: an existing folder.
    """
    pictures = files_in(folder, PHOTOGRAPH_SUFFIXES)
    left_out = are_other_maps(pictures)
    other = list(itertools.compress(pictures, left_out))
    if not other:
        return pictures
    warn_of_input(
        f"videos={folder}: {len(other)} of {len(pictures)} files ({_listed(other)}) are by their "
        "names no pictures of a camera, and are left out. Rename what is; put masks into a folder "
        "masks, named as the pictures."
    )
    return [path for path, out in zip(pictures, left_out, strict=True) if not out]


def warn_of_input(text: str) -> None:
    """Warn of an input folder, at the line two calls above the caller."""
    warnings.warn(text, CaptureWarning, stacklevel=4)


def _listed(paths: list[Path]) -> str:
    return first_of([path.name for path in paths], _NAMED)
