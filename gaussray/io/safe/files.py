"""Opens untrusted files: regular files only, inside allowed folders, JSON of limited size."""

import glob
import io
import json
import os
import re
import stat
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gaussray.io.safe.limits import limits, within


# Longest file name in a manifest, and deepest nesting of JSON; no format needs a tenth of these.
LONGEST, DEEPEST = 4096, 100
# How the small files begin that stand for large ones in a repository.
_POINTER = b"version https://git-lfs"
# Digits of an integer that fits into 64 bits.
_DIGITS = 18


def opened(path: Path | str) -> io.BufferedReader:
    """Open a regular file for reading bytes.

    Raises:
        FileNotFoundError: there is no such file.
        OSError: the file cannot be opened, is a folder, a pipe or a device, or a pointer of Git
            LFS.
    """
    # O_NONBLOCK: opening a pipe does not wait for a writer. O_BINARY: Windows keeps line ends as
    # they are.
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    try:
        number = os.open(path, flags)
    except FileNotFoundError:
        raise FileNotFoundError(f"{path}: no such file.") from None
    except (OSError, ValueError) as error:
        raise OSError(f"{path}: cannot be opened: {error}") from None
    if not stat.S_ISREG(os.fstat(number).st_mode):
        os.close(number)
        raise OSError(f"{path}: must be a file, got a folder, a pipe or a device.")
    file = os.fdopen(number, "rb")
    if file.peek(len(_POINTER)).startswith(_POINTER):
        file.close()
        raise OSError(
            f"{path}: is a pointer of Git LFS, not the file itself. `git lfs pull` in its "
            "repository fetches the file."
        )
    return file


def read_binary(path: Path | str) -> bytes:
    """The bytes of a binary file of at most limits.arrays gigabytes."""
    with opened(path) as file:
        within(path, "the file in GB", os.fstat(file.fileno()).st_size, "arrays", 1e9)
        return file.read()


def read_text(path: Path | str) -> bytes:
    """The bytes of a text file of at most limits.text megabytes."""
    with opened(path) as file:
        within(path, "the text in MB", os.fstat(file.fileno()).st_size, "text", 1e6)
        # The file may grow while it is read.
        return file.read(int(limits().text * 1e6) + 1)


def parse_xml(path: Path | str, text: bytes) -> ElementTree.Element:
    """The root of an XML document, which must not declare entities.

    Args:
        path: the file, for messages.
        text: its content.

    Raises:
        ValueError: the document declares entities, or is no XML.
    """
    if b"<!DOCTYPE" in text or b"<!ENTITY" in text:
        raise ValueError(f"{path}: must not declare entities. Remove the DOCTYPE.")
    try:
        return ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as error:
        raise ValueError(f"{path}: must be XML, got {error}.") from None


def read_json(path: Path | str) -> Any:
    """The content of a JSON file. Integers beyond 64 bits become floats.

    Raises:
        ValueError: the file is larger than limits.text, not UTF-8, not JSON, or nested too deeply;
            the message names the file and the place.
        OSError: the file is missing or cannot be read.
    """
    return parse_json(path, read_text(path))


def parse_json(where: object, text: bytes | str) -> Any:
    """The content of a JSON text. Integers beyond 64 bits become floats.

    Args:
        where: what messages name, such as the file.
        text: the text; bytes must be UTF-8, with or without a byte order mark.

    Raises:
        ValueError: the text is not UTF-8, not JSON, or nested too deeply.
    """
    try:
        decoded = text.decode("utf-8-sig") if isinstance(text, bytes) else text
        content = json.loads(decoded, parse_int=_whole)
    except json.JSONDecodeError as error:
        raise ValueError(
            f"{where}: malformed JSON at line {error.lineno}, column {error.colno}: {error.msg}."
        ) from None
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{where}: the file must be UTF-8 text, got {error}. Save it as UTF-8."
        ) from None
    except RecursionError:
        content = None
    level, depth = [content], 0
    while level and depth <= DEEPEST:
        level, depth = [child for node in level for child in _containers(node)], depth + 1
    if level or content is None and decoded.strip() != "null":
        raise ValueError(f"{where}: the JSON must be nested at most {DEEPEST} deep.")
    return content


def _whole(digits: str) -> int | float:
    return int(digits) if len(digits) <= _DIGITS else float(digits)


def _containers(node: Any) -> Iterator[Any]:
    inner = node.values() if isinstance(node, dict) else node if isinstance(node, list) else ()
    return (child for child in inner if isinstance(child, dict | list))


def inside(folder: Path, name: str, where: object) -> Path:
    """The path of a file that a manifest names, relative to the manifest's folder.

    Args:
        folder: folder of the manifest.
        name: the file name in the manifest.
        where: what the error message names, such as manifest and key.

    Raises:
        ValueError: the file is outside the folder and all of limits.folders (by .., a link or an
            absolute path), or the name is not a file name.
    """
    if len(name) > LONGEST or re.search(r"[\x00-\x1f\x7f]", name):
        shown = name if len(name) <= 80 else name[:80] + "..."
        raise ValueError(f"{where} must be the name of a file, got {shown!r}.")
    path = folder / name
    try:
        real, home = path.resolve(), folder.resolve()
        known = [home, *(Path(other).expanduser().resolve() for other in limits().folders)]
    except (OSError, RuntimeError, ValueError) as error:
        raise ValueError(f"{where} must be the name of a file, got {name!r} ({error}).") from None
    if not any(real.is_relative_to(other) for other in known):
        link = _link_on_the_way(folder, name)
        if real.exists() or link is not None:
            target = real.parent if link is None or link.is_file() else link.resolve()
            allowed = target if real.is_relative_to(target) else real.parent
            through = "." if link is None else f" ({link.name} is a link)."
            through += "" if real.exists() else same_name_hint(home, name)
            remedy = (
                f"{through} Copy it there, or, if you trust the manifest, allow its folder: "
                f"limits.folders=['{allowed}']."
            )
        else:
            remedy = f" and does not exist.{same_name_hint(home, name)} Correct the name."
        raise ValueError(
            f"{where} must name a file in {home}, got {name!r}, which is {real}{remedy}"
        )
    return path


def _link_on_the_way(folder: Path, name: str) -> Path | None:
    """The first link to something that exists on the way from a folder to a file in it; None if
    there is none."""
    parts = Path(name).parts
    ways = (folder.joinpath(*parts[:count]) for count in range(1, len(parts) + 1))
    return next((way for way in ways if way.is_symlink() and way.exists()), None)


def same_name_hint(folder: Path, name: str) -> str:
    """A sentence that tells where a file of the name of an absent one lies; empty if nowhere.

    Args:
        folder: where to look, also in its folders and in theirs.
        name: the path that names no file.
    """
    path = file_of_same_name(folder, name)
    return "" if path is None else f" A file of this name is {path}."


def file_of_same_name(folder: Path, name: str) -> Path | None:
    """A file in a folder, in its folders or in theirs that has the name of an absent one; None if
    there is none.

    Args:
        folder: where to look.
        name: the path that names no file.
    """
    last = glob.escape(re.split(r"[/\\]", name)[-1])
    found = (path for place in ("", "*/", "*/*/") for path in folder.glob(place + last))
    return next((path for path in found if path.is_file()), None)
