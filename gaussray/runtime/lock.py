"""One process at a time for a folder of output."""

import contextlib
import errno
import functools
import inspect
import os
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import ParamSpec, TypeVar

from gaussray.runtime.devices import leads


P = ParamSpec("P")
R = TypeVar("R")

try:
    import fcntl
except ImportError:  # a system without such locks has none here
    fcntl = None


# Says who works there: removed at the end, left by a process that was killed, and then of no use.
FILE = ".gaussray.lock"
# File systems that know no locks.
_LOCKLESS = {errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP}
# Descriptors of this process's locks, and whether their folders were made for them.
_held: dict[Path, tuple[int, bool]] = {}


@contextlib.contextmanager
def alone(out: Path | str, part: str = "") -> Iterator[None]:
    """Within the block no other process writes into `out`, or works on this `part` of it; an
    OSError names the one that does. A process may hold a folder several times over."""
    new = take(out, part)
    try:
        yield
    finally:
        if new is not None:
            _release(new)


def holds_out(function: Callable[P, R]) -> Callable[P, R]:
    """The function, at work `alone` in the folder that it is given as `out`."""
    signature = inspect.signature(function)

    @functools.wraps(function)
    def held(*args: P.args, **kwargs: P.kwargs) -> R:
        with alone(signature.bind(*args, **kwargs).arguments["out"]):
            return function(*args, **kwargs)

    return held


def take(out: Path | str, part: str = "") -> Path | None:
    """Hold a folder, which is made, until `release` or the end of the process, however that comes:
    the system forgets the lock. The lock's file, None if it was held already. Of several hosts the
    first one holds it for all."""
    name = FILE if not part else f".gaussray.{part.replace('/', '-')}.lock"
    path = Path(out).absolute() / name
    if path in _held or fcntl is None or not leads():
        return None
    made = not path.parent.exists()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _held[path] = _locked(path), made
    except BlockingIOError as error:
        who = _holder(path)
        raise OSError(
            f"out={out}: {who} is writing there. Wait for it, or choose another folder."
        ) from error
    except OSError as error:
        raise OSError(f"out={out}: cannot be written: {error.strerror}") from error
    return path


def release() -> None:
    """Let go of all folders that are held."""
    for path in list(_held):
        _release(path)


def _locked(path: Path) -> int:
    """The descriptor of a locked file that says who holds it."""
    while True:
        file = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            _lock(file)
            # The one before may have removed it between the opening and the lock.
            if _is_at(file, path):
                os.ftruncate(file, 0)
                os.write(file, f"{os.getpid()} {socket.gethostname()}\n".encode())
                return file
        except BaseException:
            os.close(file)
            raise
        os.close(file)


def _lock(file: int) -> None:
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # type: ignore[union-attr]
    except OSError as error:
        if error.errno not in _LOCKLESS:
            raise


def _is_at(file: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(file), os.stat(path))
    except FileNotFoundError:
        return False


def _holder(path: Path) -> str:
    """Who holds a lock, as far as its file tells."""
    with contextlib.suppress(OSError, ValueError):
        pid, host = path.read_text().split()
        return f"process {int(pid)} on {host}"
    return "another process"


def _release(path: Path) -> None:
    file, made = _held.pop(path)
    # Before it is unlocked: whoever waits for it finds that it is gone, and makes one anew.
    with contextlib.suppress(OSError):
        path.unlink()
        if made:
            path.parent.rmdir()  # where nothing came of it
    os.close(file)
