"""Files of a folder told by how they begin, and which of several projects is read."""

import codecs
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.transforms import json_if_readable
from gaussray.io.safe.files import opened
from gaussray.runtime.output import first_of


# Bytes at the start of a file that tell what it is.
_HEAD = 100_000


def head_of(path: Path) -> bytes:
    """The first 100,000 bytes of a text without its byte order mark; none if it cannot be read."""
    try:
        with opened(path) as file:
            return file.read(_HEAD).removeprefix(codecs.BOM_UTF8)
    except OSError:
        return b""


def begins_with(path: Path, pattern: bytes) -> bool:
    """Whether the head of a file (`head_of`) has a pattern.

    Args:
        path: the file.
        pattern: a regular expression that is searched for.
    """
    return re.search(pattern, head_of(path)) is not None


def projects_in(folder: Path, places: Iterable[str], head: bytes) -> list[Path]:
    """The projects of a program in a folder.

    Args:
        folder: the capture's folder.
        places: patterns of their paths in it, in the order of the result.
        head: a regular expression of what their heads have (`begins_with`).
    """
    paths = (path for place in places for path in sorted(folder.glob(place)))
    return [path for path in paths if begins_with(path, head)]


def fullest_project(
    paths: Sequence[Path], rank: Callable[[Path, Mapping], tuple[int, ...]]
) -> Path | None:
    """The JSON file that ranks highest, the first of several; None if there is no file.

    Args:
        paths: the files.
        rank: of a file and its content, such as the number of its poses.
    """
    if len(paths) < 2:
        return paths[0] if paths else None
    contents = {path: json_if_readable(path) for path in paths}
    ranks = {
        path: rank(path, content) for path, content in contents.items() if isinstance(content, dict)
    }
    return max(ranks, key=ranks.__getitem__) if ranks else paths[0]


def warn_of_projects(top: Keys, paths: Sequence[Path]) -> None:
    """Name the other projects of a folder, which are not read.

    Args:
        top: the one that is read.
        paths: all of them.
    """
    others = [str(path) for path in paths if path != top.file]
    if others:
        top.warn(
            f"of {len(paths)} projects this one is read, and {first_of(others)} is not. Move it "
            "away to read another."
        )
