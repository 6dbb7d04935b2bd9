"""How large a picture may be to be made in time."""

import math
from collections.abc import Sequence


# Widths of pictures, each about one and a half times the one before: few, for each is compiled.
WIDTHS = (64, 96, 128, 192, 256, 384, 512, 768, 1024, 1536, 2048, 3072, 4096)
# How much of a new measurement enters the mean, and how much larger than predicted as feasible a
# picture must be before it grows: sizes shall not flicker.
SHARE, RESERVE = 0.3, 1.3
# Of the time of a small picture, what has nothing to do with its size.
GUESS = 0.5


def ladder(full: tuple[int, int]) -> list[tuple[int, int]]:
    """The sizes of a picture up to the full one, smallest first, of its shape."""
    width, height = full
    smaller = [w for w in WIDTHS if w < width]
    return [(w, max(round(w * height / width), 1)) for w in smaller] + [full]


class Pacer:
    """Chooses the size for a time budget from the times of pictures that were made.

    A picture takes a + b n milliseconds for n rays: what happens to the Gaussians, however few rays
    there are, and what happens to rays. Of each n the running mean is kept, and the line through
    the nearest two tells of others. The first picture alone does not tell a, which is taken for
    `GUESS` of its time.
    """

    def __init__(self, sizes: Sequence[tuple[int, int]], budget: float):
        self.sizes, self.budget = list(sizes), budget
        self._mean: dict[int, float] = {}
        self._held = self.sizes[0]

    def measured(self, size: tuple[int, int], rays: int, milliseconds: float) -> None:
        """A picture of this size took so long, with so many rays a pixel in all."""
        count = size[0] * size[1] * rays
        old = self._mean.get(count, milliseconds)
        self._mean[count] = old + SHARE * (milliseconds - old)
        # What is slow for a while (another program compiles) makes everything slow.
        ratio = self._mean[count] / old if old else 1.0
        self._mean = {n: t if n == count else ratio * t for n, t in self._mean.items()}

    def milliseconds(self, count: int) -> float | None:
        """How long a picture of so many rays is expected to take; None before any was made."""
        if not self._mean:
            return None
        near = sorted(self._mean, key=lambda n: abs(math.log(n / count)))
        first = self._mean[near[0]]
        if len(near) == 1:
            slope = (1 - GUESS) * first / near[0]
        else:
            slope = (self._mean[near[1]] - first) / (near[1] - near[0])
        # Neither part is less than nothing.
        slope = min(max(slope, 0.0), first / near[0])
        return first + slope * (count - near[0])

    def size(self, rays: int) -> tuple[int, int]:
        """The largest size whose pictures of so many rays a pixel are made within the budget; the
        smallest if none is, or if nothing is known."""
        fits = self.sizes[0]
        for size in self.sizes:
            reserve = RESERVE if size[0] > self._held[0] else 1.0
            taken = self.milliseconds(size[0] * size[1] * rays)
            if taken is not None and reserve * taken <= self.budget:
                fits = size
        self._held = fits
        return fits
