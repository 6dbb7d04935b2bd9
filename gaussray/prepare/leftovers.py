"""Folders for COLMAP in the output folder, and what killed processes left of them."""

import contextlib
import re
import shutil
from pathlib import Path

from gaussray.runtime.lock import holds_lock


# Beginning of the name of such a folder, which holds pictures and databases, and an empty file in
# it that tells whose it is.
WORK_PREFIX = ".gaussray-prepare-"
_MARKER = "made-by-gaussray-prepare"


def mark_work(folder: Path) -> None:
    """Mark a new folder for COLMAP as one that the next process may remove."""
    (folder / _MARKER).touch()


def remove_leftovers(out: Path) -> None:
    """Remove the folders that killed processes left for COLMAP in an output folder.

    Only marked ones are, and empty ones of their name; and none where this process holds no lock
    of the output folder, as on a file system without locks: another one may work in them.
    """
    if not holds_lock(out):
        return
    for folder in out.glob(f"{WORK_PREFIX}*"):
        ending = folder.name.removeprefix(WORK_PREFIX)
        if not re.fullmatch(r"[a-z0-9_]{8}", ending) or folder.is_symlink():
            continue
        if (folder / _MARKER).is_file():
            shutil.rmtree(folder, ignore_errors=True)
        else:
            # Of a process that was killed before it marked it.
            with contextlib.suppress(OSError):
                folder.rmdir()
