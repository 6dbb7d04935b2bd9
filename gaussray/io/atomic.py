"""Atomic file writes: a file is complete or absent, also after a crash."""

import contextlib
import json
import os
import secrets
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any


# Part of the name of an unfinished file.
PART = ".part"


@contextlib.contextmanager
def atomic_path(path: Path | str) -> Iterator[Path]:
    """A temporary path beside `path`, which replaces `path` at the end of the block.

    The temporary file has the same suffix. Missing folders are created. If the block raises, the
    temporary file is removed and `path` stays as it was.

    Raises:
        OSError: the file or its folder cannot be written; the message names `path`.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OSError(f"{path}: its folder cannot be made: {error.strerror}") from error
    # Threads may write the same file, and so may hosts whose processes have the same number.
    own = f"{os.getpid()}-{secrets.token_hex(4)}"
    partial = path.with_name(f".{path.stem}.{own}{PART}{path.suffix}")
    try:
        yield partial
        os.replace(partial, path)
    except OSError as error:
        # An error about another file keeps its own message.
        others = error.filename not in (None, str(partial), partial)
        if others or str(error).startswith(f"{path}:"):
            raise
        raise OSError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        with contextlib.suppress(OSError):
            partial.unlink()


def write_json(path: Path | str, value: dict[str, Any]) -> None:
    """Write a JSON file atomically.

    Args:
        path: the file; missing folders are made.
        value: what it holds, values that JSON can hold.
    """
    with atomic_path(path) as partial:
        partial.write_text(json.dumps(value, indent=2) + "\n")


def flush_to_disk(path: Path) -> None:
    """Wait until a file is on the disk, so that a power cut leaves the old file or the new one."""
    with open(path, "rb") as file:
        os.fsync(file.fileno())


def remove_partial_files(folder: Path, *, deep: bool = False) -> None:
    """Remove the unfinished files of killed processes.

    Args:
        folder: the folder; no other process may be writing there.
        deep: whether to remove them from the folders below it, too.
    """
    for partial in (folder.rglob if deep else folder.glob)(f".*.[0-9]*{PART}*"):
        with contextlib.suppress(OSError):
            partial.unlink()


def check_files_exist(out: Path, files: Sequence[str]) -> None:
    """Check at the end of a command that the files it wrote still exist.

    Args:
        out: the output folder.
        files: paths of the files in that folder.

    Raises:
        OSError: files are missing.
    """
    missing = [file for file in files if not (out / file).exists()]
    if missing:
        raise OSError(
            f"out={out}: {len(missing)} of {len(files)} files have gone since they were written, "
            f"such as {missing[0]}. The same command makes them again."
        )
