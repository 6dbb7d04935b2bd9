"""The programs that the last process of a kind read from disk: the next one reads them in threads
before it asks for them, while it still imports modules and opens files."""

import contextlib
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

from gaussray.runtime.program_content import loaded_program, read_content
from gaussray.runtime.program_files import full_text, is_own, kept_file, write_kept


# Programs that are read ahead at most: those asked for last.
_MOST = 64
_ahead: dict[Path, Future[Callable[..., Any]]] = {}
# The list of this process's kind, and what is on it.
_lists: dict[Path, list[str]] = {}


def read_ahead(kind: str) -> None:
    """Begin to read the programs that the last process of this kind asked for; note which ones this
    process asks for. Where programs are not kept, nothing is done.

    Args:
        kind: what tells processes apart that need other programs, as a command and its capture.
    """
    path = kept_file(full_text(("recent programs", kind)))
    if path is None:
        return
    names: list[str] = []
    with contextlib.suppress(OSError, ValueError):
        if is_own(path):
            names = path.read_text(encoding="utf-8").split()
    _lists.clear()
    _lists[path] = names
    if not names:
        return
    threads = ThreadPoolExecutor(4, "ahead")
    for name in names:
        file = path.parent / name
        _ahead[file] = threads.submit(_load, file)
    threads.shutdown(wait=False)


def remember(path: Path) -> None:
    """Put a program on the list of what processes of this kind ask for.

    Args:
        path: its file.
    """
    for file, names in _lists.items():
        if path.name not in names:
            names.append(path.name)
            with contextlib.suppress(OSError):
                write_kept(file, "\n".join(names[-_MOST:]).encode())


def read_before(path: Path) -> Callable[..., Any] | None:
    """The program of a file, if it was read ahead; None if it was not, or could not be.

    Args:
        path: the file.
    """
    future = _ahead.pop(path, None)
    if future is None:
        return None
    with contextlib.suppress(Exception):
        return future.result()
    return None


def _load(path: Path) -> Callable[..., Any]:
    if not is_own(path):
        raise ValueError(f"{path} belongs to another user")
    return loaded_program(read_content(path))
