"""How long JAX has compiled so far in this process."""

import threading
import time

import jax


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
