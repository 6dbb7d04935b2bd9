"""Files of strangers: where they may lie, and what opening one may do."""

import io
import json
import os
import re
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gaussray.io.safe.limits import limits, within


# Longest name of a file in a list, and deepest nesting of a JSON text: no format needs a tenth.
LONGEST, DEEPEST = 4096, 100
# Digits of a whole number that certainly fits into 64 bits.
_DIGITS = 18


def opened(path: Path | str) -> io.BufferedReader:
    """A regular file, to be read as bytes.

    A pipe, device or folder is refused, and never waited for. FileNotFoundError or another OSError,
    naming the file.
    """
    # O_NONBLOCK: opening a pipe does not wait for a writer. O_BINARY: Windows keeps line ends.
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
    return os.fdopen(number, "rb")


def read_text(path: Path | str) -> bytes:
    """The bytes of a text, of at most limits.text megabytes."""
    with opened(path) as file:
        within(path, "the text in MB", os.fstat(file.fileno()).st_size, "text", 1e6)
        # It may grow while it is read.
        return file.read(int(limits().text * 1e6) + 1)


def read_json(path: Path | str) -> Any:
    """What a JSON file holds; whole numbers beyond 64 bits as fractions.

    ValueError for what is no JSON, no UTF-8 or nested too deeply, naming file and place.
    """
    return parse_json(path, read_text(path))


def parse_json(where: object, text: bytes | str) -> Any:
    """The same of a text; `where` it stands is named."""
    try:
        told = text.decode("utf-8") if isinstance(text, bytes) else text
        content = json.loads(told, parse_int=_whole)
    except json.JSONDecodeError as error:
        raise ValueError(
            f"{where}: malformed JSON at line {error.lineno}, column {error.colno}: {error.msg}."
        ) from None
    except UnicodeDecodeError as error:
        raise ValueError(f"{where}: the file must be UTF-8 text, got {error}.") from None
    except RecursionError:
        content = None
    level, depth = [content], 0
    while level and depth <= DEEPEST:
        level, depth = [child for node in level for child in _containers(node)], depth + 1
    if level or content is None and told.strip() != "null":
        raise ValueError(f"{where}: the JSON must be nested at most {DEEPEST} deep.")
    return content


def _whole(digits: str) -> int | float:
    return int(digits) if len(digits) <= _DIGITS else float(digits)


def _containers(node: Any) -> Iterator[Any]:
    inner = node.values() if isinstance(node, dict) else node if isinstance(node, list) else ()
    return (child for child in inner if isinstance(child, dict | list))


def inside(folder: Path, name: str, where: object) -> Path:
    """The path of a file that a list names, in the folder of that list.

    ValueError, beginning with `where` the name stands, if it leaves the folder, by .. or links or
    because it begins at the root, unless to a folder of limits.folders.
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
        raise ValueError(
            f"{where} must name a file in {home}, got {name!r}, which is {real}. Copy it there, "
            f"or, if you trust the list, allow its folder: limits.folders=['{real.parent}']."
        )
    return path
