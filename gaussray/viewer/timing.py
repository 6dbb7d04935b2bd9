"""Status of the picture in the viewer: frames per second and milliseconds per stage."""

import time as clock
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

from gaussray.runtime.output import counted


PREVIEW_STAGES = ("tracing", "developing", "encoding")
# Frames in the mean rate; a pause of this many seconds starts a new mean.
_FRAMES, _PAUSE = 12, 1.5


class RenderStatus(NamedTuple):
    """Status of a picture: `size` in pixels, `rays` per pixel, milliseconds per stage, `hits`
    (Gaussians per ray), `dropped` list entries, whether it is the `final` picture, the number of
    programs `compiling`, and frames per second (`rate`, 0 at rest)."""

    size: tuple[int, int]
    rays: int
    stages: dict[str, float]
    hits: float
    dropped: int
    final: bool
    compiling: int
    rate: float = 0.0


class StageTimer:
    """Measures the stages of consecutive pictures."""

    def __init__(self):
        self.stages: dict[str, float] = {name: 0.0 for name in PREVIEW_STAGES}
        self._ends: deque[float] = deque(maxlen=_FRAMES)

    def begin(self) -> None:
        """Start a new picture: reset all stages."""
        self.stages = {name: 0.0 for name in PREVIEW_STAGES}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the duration of the block to a stage."""
        begin = clock.monotonic()
        yield
        self.stages[name] += 1000 * (clock.monotonic() - begin)

    def finish(self) -> float:
        """End a picture. Returns the frames per second since the last pause, 0 after a pause."""
        now = clock.monotonic()
        if self._ends and now - self._ends[-1] > _PAUSE:
            self._ends.clear()
        self._ends.append(now)
        span = now - self._ends[0]
        return (len(self._ends) - 1) / span if span > 0 else 0.0


# What the status line calls the stages.
_STAGE_NAMES = {"tracing": "ray tracing", "developing": "sensor", "encoding": "image encoding"}


def status_text(status: RenderStatus) -> str:
    """A status as Markdown lines."""
    compiling = f"compiling {counted(status.compiling, 'program')} ..."
    if not status.stages:
        return f"**Preparing the first preview**  \n{compiling}"
    width, height = status.size
    picture = [
        f"{width} x {height} pixels",
        f"{counted(status.rays, 'ray')} per pixel",
    ]
    if status.final:
        picture.insert(0, "**Final picture**")
    elif status.rate:
        picture.insert(0, f"**Preview, {status.rate:.1f} frames/s**")
    else:
        picture.insert(0, "**Preview**")
    stages = " · ".join(
        f"{_STAGE_NAMES.get(name, name)} {ms:.0f} ms" for name, ms in status.stages.items() if ms
    )
    lines = [" · ".join(picture), stages, f"{status.hits:.1f} Gaussians hit per ray"]
    if status.dropped:
        lines.append(f"{status.dropped} list entries dropped; the lists are being enlarged")
    if status.compiling:
        lines.append(compiling)
    return "  \n".join(lines)
