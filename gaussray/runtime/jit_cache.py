"""The compilation cache on disk, and the time that this process has spent on compilation."""

import contextlib
import hashlib
import os
import threading
import time
from pathlib import Path

import jax

from gaussray.runtime.program_files import keep_machine_code


# Programs that take this many seconds to compile are kept; loading one takes milliseconds.
MIN_COMPILE_SECONDS = 0.005
# Prefix of the names under which JAX reports the duration of tracing, lowering and XLA.
EVENTS = "/jax/core/compile/"


class Clock:
    """Sums the durations of compilation that JAX reports.

    Intervals that overlap, because one compilation contains another or threads compile at the same
    time, count once.
    """

    def __init__(self):
        self._pieces: list[tuple[float, float]] = []
        self._sum, self._lock = 0.0, threading.Lock()

    @property
    def seconds(self) -> float:
        """Total duration so far, in seconds."""
        return self._sum + sum(end - begin for begin, end in self._pieces)

    def hear(self, event: str, duration_secs: float, **_: str | int) -> None:
        """Add an interval that has just ended; a listener of `jax.monitoring`.

        Args:
            event: name of what took the time; only names that begin with `EVENTS` count.
            duration_secs: length of the interval in seconds.
            _: what else JAX reports of the event.
        """
        if event.startswith(EVENTS):
            end = time.monotonic()
            with self._lock:
                self._add(end - duration_secs, end)

    def _add(self, begin: float, end: float) -> None:
        """Intervals end in order, so that only the last ones can overlap a new one."""
        while self._pieces and self._pieces[-1][1] > begin:
            begin = min(begin, self._pieces.pop()[0])
        self._pieces.append((begin, end))
        if len(self._pieces) > 256:
            first, last = self._pieces.pop(0)
            self._sum += last - first


_clock: list[Clock] = []


def compiled() -> float:
    """Seconds of compilation in this process since the first call of this function."""
    if not _clock:
        _clock.append(Clock())
        jax.monitoring.register_event_duration_secs_listener(_clock[0].hear)
    return _clock[0].seconds


def keep_programs(folder: str) -> Path | None:
    """Keep compiled programs in a folder, so that later processes load instead of compile them.

    The environment variables JAX_COMPILATION_CACHE_DIR and
    JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS have precedence over `folder` and
    `MIN_COMPILE_SECONDS`.

    Args:
        folder: the folder, or `auto` for a folder of the user's cache per kind of processor, since
            machine code of one processor may not run on another. Empty: programs are not kept.

    Returns:
        The folder in use; None if programs are not kept, also where the user's cache cannot be
        written.

    Raises:
        OSError: `folder` is not auto and cannot be written.
    """
    known = jax.config.values["jax_compilation_cache_dir"]
    if known:
        keep_machine_code(Path(known), _processor())
        _keep_short_ones()
        return Path(known)
    if not folder:
        return None
    path = Path(folder) if folder != "auto" else _cache() / "gaussray" / _processor()
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        if folder != "auto":
            raise OSError(f"devices.programs={folder}: cannot be written: {error}") from error
        return None
    keep_machine_code(path, _processor())
    jax.config.update("jax_compilation_cache_dir", str(path))
    _keep_short_ones()
    return path


def _keep_short_ones() -> None:
    """Keep programs that compile in less than JAX's second, too: a fit has hundreds of them."""
    if "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS" not in os.environ:
        jax.config.update("jax_persistent_cache_min_compile_time_secs", MIN_COMPILE_SECONDS)


def _cache() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def _processor() -> str:
    """A hash of the processor's architecture and instruction sets."""
    features = os.uname().machine if hasattr(os, "uname") else ""
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        features += next((line for line in lines if line.startswith(("flags", "Features"))), "")
    return hashlib.sha256(features.encode()).hexdigest()[:16]
