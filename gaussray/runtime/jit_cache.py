"""Compiled programs: kept from run to run, and how long this process has compiled."""

import contextlib
import hashlib
import os
import threading
import time
from pathlib import Path

import jax


# Programs that took this long are kept; to load one takes milliseconds.
MIN_COMPILE_SECONDS = 0.2
# Tracing, lowering and XLA; JAX says of each how long it took.
EVENTS = "/jax/core/compile/"


class Clock:
    """Seconds spent on compilation, by what JAX reports at the end of each piece of it. Pieces
    within one another, or at once in several threads, count once."""

    def __init__(self):
        self._pieces: list[tuple[float, float]] = []
        self._sum, self._lock = 0.0, threading.Lock()

    @property
    def seconds(self) -> float:
        """All pieces so far."""
        return self._sum + sum(end - begin for begin, end in self._pieces)

    def hear(self, event: str, duration_secs: float, **_: str | int) -> None:
        """A piece has just ended."""
        if event.startswith(EVENTS):
            end = time.monotonic()
            with self._lock:
                self._add(end - duration_secs, end)

    def _add(self, begin: float, end: float) -> None:
        """Pieces end in order, so that only the last ones can overlap a new one."""
        while self._pieces and self._pieces[-1][1] > begin:
            begin = min(begin, self._pieces.pop()[0])
        self._pieces.append((begin, end))
        if len(self._pieces) > 256:
            first, last = self._pieces.pop(0)
            self._sum += last - first


_clock: list[Clock] = []


def compiled() -> float:
    """Seconds that this process has compiled since this was first asked."""
    if not _clock:
        _clock.append(Clock())
        jax.monitoring.register_event_duration_secs_listener(_clock[0].hear)
    return _clock[0].seconds


def keep_programs(folder: str) -> Path | None:
    """Have JAX keep what it compiles in a folder, and load it from there instead of compiling it
    again, in whichever process; where that is, if anywhere.

    `auto` is the user's cache, a folder for every kind of processor (machine code of one may be
    none of another), unless the environment's JAX_COMPILATION_CACHE_DIR says where, and nowhere if
    it cannot be written; an empty text is nowhere.
    """
    known = jax.config.values["jax_compilation_cache_dir"]
    if known:
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
    jax.config.update("jax_compilation_cache_dir", str(path))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", MIN_COMPILE_SECONDS)
    return path


def _cache() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def _processor() -> str:
    """A name for what this processor can do."""
    told = os.uname().machine if hasattr(os, "uname") else ""
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        told += next((line for line in lines if line.startswith(("flags", "Features"))), "")
    return hashlib.sha256(told.encode()).hexdigest()[:16]
