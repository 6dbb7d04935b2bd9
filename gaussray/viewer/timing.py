"""What a picture on the page cost: frames a second, and milliseconds of each stage."""

import time as clock
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple


STAGES = ("tracing", "developing", "encoding")
# Frames over which the rate is a mean, and seconds after which one is no part of a motion.
FRAMES, PAUSE = 12, 1.5


class Reading(NamedTuple):
    """What is told of a picture: its `size`, `rays` a pixel, milliseconds of every stage, `hits`
    per ray, candidates `dropped`, whether it is as `render` makes it (`whole`), and programs that
    are being compiled. `rate` is 0 where nothing moves."""

    size: tuple[int, int]
    rays: int
    stages: dict[str, float]
    hits: float
    dropped: int
    whole: bool
    building: int
    rate: float = 0.0


class Meter:
    """Times the stages of one picture after the other."""

    def __init__(self):
        self.stages: dict[str, float] = {name: 0.0 for name in STAGES}
        self._ends: deque[float] = deque(maxlen=FRAMES)

    def begin(self) -> None:
        """A new picture: all stages from zero."""
        self.stages = {name: 0.0 for name in STAGES}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Adds what the block takes to a stage."""
        begin = clock.monotonic()
        yield
        self.stages[name] += 1000 * (clock.monotonic() - begin)

    def finish(self) -> float:
        """The picture is on its way; frames a second of the motion it is part of, or 0."""
        now = clock.monotonic()
        if self._ends and now - self._ends[-1] > PAUSE:
            self._ends.clear()
        self._ends.append(now)
        span = now - self._ends[0]
        return (len(self._ends) - 1) / span if span > 0 else 0.0


def sentence(reading: Reading, k: int) -> str:
    """A reading in words."""
    if not reading.stages:
        return f"**preparing the first picture**  \ncompiling {reading.building} programs ..."
    w, h = reading.size
    told = [f"{w} x {h} px, {reading.rays} rays a pixel"]
    if reading.whole:
        told.insert(0, "**as rendered**")
    elif reading.rate:
        told.insert(0, f"**{reading.rate:.1f} frames/s**")
    stages = " · ".join(f"{name} {ms:.0f}" for name, ms in reading.stages.items() if ms)
    counts = f"k = {k} · {reading.hits:.1f} hits a ray · {reading.dropped} dropped"
    state = "all programs ready"
    if reading.building:
        state = f"compiling {reading.building} program{'s' * (reading.building > 1)} ..."
    lines = [" · ".join(told), f"{stages} ms", counts, state]
    return "  \n".join(lines)
