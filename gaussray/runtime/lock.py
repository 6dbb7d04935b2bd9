"""Locks of output folders: one process at a time writes into a folder."""

import contextlib
import errno
import functools
import inspect
import os
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple, ParamSpec, TypeVar

from filelock import FileLock, Timeout

from gaussray.runtime.devices import is_primary


P = ParamSpec("P")
R = TypeVar("R")

# The lock of a folder. Its file is removed at the end; a killed process leaves a file without lock.
LOCK_FILE = ".gaussray.lock"
# File systems without locks answer with these; the folder is then used without one.
_NO_LOCKS = {errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP}


class _Held(NamedTuple):
    """A lock of this process; `made` tells whether its folder was made for it."""

    lock: FileLock
    made: bool


_held: dict[Path, _Held] = {}


@contextlib.contextmanager
def output_lock(out: Path | str) -> Iterator[None]:
    """Lock an output folder within the block.

    A process may lock the same folder several times; the outermost block releases it.

    Args:
        out: the output folder; it is made if missing, and removed again if it stays empty.

    Raises:
        OSError: another process holds the lock, or the folder cannot be written.
    """
    path = lock_output(out)
    try:
        yield
    finally:
        if path is not None:
            _release(path)


def locks_output(function: Callable[P, R]) -> Callable[P, R]:
    """Decorate a function that has an argument `out`: the folder is locked while it runs."""
    signature = inspect.signature(function)

    @functools.wraps(function)
    def locked(*args: P.args, **kwargs: P.kwargs) -> R:
        with output_lock(signature.bind(*args, **kwargs).arguments["out"]):
            return function(*args, **kwargs)

    return locked


def lock_output(out: Path | str, part: str = "") -> Path | None:
    """Lock an output folder until `release_locks` or the end of the process.

    The operating system drops the lock of a process that is killed. With several hosts, process 0
    holds the lock for all of them.

    Args:
        out: the output folder; it is made if missing.
        part: name of a share of the folder's work that has a lock of its own ("0/4").

    Returns:
        The lock's file, or None if this process held the lock already or another host holds it.

    Raises:
        OSError: another process holds the lock, or the folder cannot be written.
    """
    name = LOCK_FILE if not part else f".gaussray.{part.replace('/', '-')}.lock"
    path = Path(out).absolute() / name
    if path in _held or not is_primary():
        return None
    made = not path.parent.exists()
    lock = FileLock(path, timeout=0, thread_local=False)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        lock.acquire()
        _owner(path).write_text(f"{os.getpid()} {socket.gethostname()}\n")
    except Timeout as error:
        raise OSError(
            f"out={out}: {_holder(path)} is writing there. Wait for it, or choose another folder."
        ) from error
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            lock.release()
            reason = "it is a file, not a folder" if Path(out).is_file() else error.strerror
            raise OSError(f"out={out}: cannot be written: {reason}") from error
    _held[path] = _Held(lock, made)
    return path


def holds_lock(out: Path | str) -> bool:
    """Whether this process holds the lock of an output folder; False on a file system without
    locks."""
    held = _held.get(Path(out).absolute() / LOCK_FILE)
    return held is not None and held.lock.is_locked


def release_locks() -> None:
    """Release all locks of this process."""
    for path in list(_held):
        _release(path)


def _owner(path: Path) -> Path:
    """The file beside a lock that names the process; Windows lets nobody read a locked file."""
    return path.with_suffix(".owner")


def _holder(path: Path) -> str:
    """The process that holds a lock, as far as the file beside the lock tells."""
    with contextlib.suppress(OSError, ValueError):
        pid, host = _owner(path).read_text().split()
        return f"process {int(pid)} on {host}"
    return "another process"


def _release(path: Path) -> None:
    lock, made = _held.pop(path)
    for file in (_owner(path), path):
        # Before the release: a process that waits finds the file gone and makes a new one. Windows
        # refuses to remove an open file; filelock removes it there after the release.
        with contextlib.suppress(OSError):
            file.unlink()
    if made:
        with contextlib.suppress(OSError):
            path.parent.rmdir()
    lock.release()
