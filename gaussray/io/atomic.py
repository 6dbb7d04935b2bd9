"""Files that appear whole or not at all."""

import contextlib
import json
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any


# In the name of what is not whole yet.
PART = ".part"


@contextlib.contextmanager
def whole(path: Path | str) -> Iterator[Path]:
    """A temporary name beside `path`, same suffix, moved onto it when the block ends well.

    Missing folders are made. If the block raises, the temporary file is removed and `path` is left
    as it was; an OSError of the writing becomes one that names `path`.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OSError(f"{path}: its folder cannot be made: {error.strerror}") from error
    partial = path.with_name(f".{path.stem}.{os.getpid()}{PART}{path.suffix}")
    try:
        yield partial
        os.replace(partial, path)
    except OSError as error:
        # Others' errors name their own file.
        others = error.filename not in (None, str(partial), partial)
        if others or str(error).startswith(f"{path}:"):
            raise
        raise OSError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        with contextlib.suppress(OSError):
            partial.unlink()


def write_json(path: Path | str, value: dict[str, Any]) -> None:
    """Write a JSON file, whole or not at all."""
    with whole(path) as partial:
        partial.write_text(json.dumps(value, indent=2) + "\n")


def settle(path: Path) -> None:
    """Wait until what was written of a file is on the disk: what a power cut leaves is then the
    file before it or all of this one."""
    with open(path, "rb") as file:
        os.fsync(file.fileno())


def sweep(folder: Path, *, deep: bool = False) -> None:
    """Remove what killed processes have left of files that were not whole, in `folder` or, `deep`,
    also below it. Nothing else may be writing there."""
    for partial in (folder.rglob if deep else folder.glob)(f".*.[0-9]*{PART}*"):
        with contextlib.suppress(OSError):
            partial.unlink()


def demand(out: Path, files: Sequence[str]) -> None:
    """Refuse to call a work done of which files have gone from `out` since they were written."""
    gone = [file for file in files if not (out / file).exists()]
    if gone:
        raise OSError(
            f"out={out}: {len(gone)} of {len(files)} files have gone since they were written, such "
            f"as {gone[0]}. The same command makes them again."
        )
