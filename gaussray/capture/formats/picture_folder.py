"""Folders of pictures and of videos, by whatever name."""

from collections.abc import Sequence
from pathlib import Path

from gaussray.capture.formats.picture_places import KNOWN_SUFFIXES
from gaussray.capture.side_folders import holds_other_maps
from gaussray.capture.videos import VIDEO_SUFFIXES


_MEDIA = (*KNOWN_SUFFIXES, *VIDEO_SUFFIXES, ".heic")
# Folders beside each other that are looked at.
_LOOKED_AT = 50


def only_picture_folder(folder: Path, names: Sequence[str]) -> Path | None:
    """The first folder of one of these names that holds pictures, else the only folder that does;
    None if there is none, or several. Folders of depth maps, masks and the like do not count.

    Args:
        folder: where to look.
        names: names that count before others.
    """
    named = next((folder / name for name in names if _holds_pictures(folder / name)), None)
    if named is not None:
        return named
    beside = sorted(path for path in folder.iterdir() if path.is_dir())[:_LOOKED_AT]
    holding = [path for path in beside if not holds_other_maps(path) and _holds_pictures(path)]
    return holding[0] if len(holding) == 1 else None


def _holds_pictures(folder: Path) -> bool:
    if not folder.is_dir():
        return False
    return any(path.suffix.lower() in KNOWN_SUFFIXES for path in folder.iterdir())


def folders_in(folder: Path) -> list[Path]:
    """The first folders in a folder, and in these."""
    outer = sorted(path for path in folder.iterdir() if path.is_dir())[:_LOOKED_AT]
    inner = [path for some in outer for path in sorted(some.iterdir()) if path.is_dir()]
    return outer + inner[:_LOOKED_AT]


def media_folder(folder: Path) -> Path | None:
    """The folder of a camera's pictures or of videos; that of these folders if there are several.
    None if there is none.

    Args:
        folder: where to look, also in its folders and in theirs.
    """
    if _holds_media(folder):
        return folder
    holding = [path for path in folders_in(folder) if _holds_media(path)]
    holding = [path for path in holding if not holds_other_maps(path)] or holding
    if not holding:
        return None
    parents = {path.parent for path in holding}
    named = [path for path in holding if path.name in ("images", "videos", "input")]
    return named[0] if named else holding[0] if len(holding) == 1 else min(parents)


def media_in(folder: Path) -> list[Path]:
    """The pictures and videos in a folder, and the folders that hold some."""
    return [
        path
        for path in sorted(folder.iterdir())
        if path.suffix.lower() in _MEDIA or (path.is_dir() and _holds_media(path))
    ]


def _holds_media(folder: Path) -> bool:
    return any(path.suffix.lower() in _MEDIA for path in folder.iterdir() if path.is_file())
