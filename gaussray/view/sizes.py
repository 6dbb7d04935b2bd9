"""How large a picture may be to be made in time."""

from collections.abc import Sequence


# Widths of pictures, each about one and a half times the one before: few, for each is compiled.
WIDTHS = (64, 96, 128, 192, 256, 384, 512, 768, 1024, 1536, 2048, 3072, 4096)
# How much of a new measurement enters the mean, and how much larger than predicted as feasible a
# picture must be before it grows: sizes shall not flicker.
SHARE, RESERVE = 0.3, 1.3


def ladder(full: tuple[int, int]) -> list[tuple[int, int]]:
    """The sizes of a picture up to the full one, smallest first, of its shape."""
    width, height = full
    smaller = [w for w in WIDTHS if w < width]
    return [(w, max(round(w * height / width), 1)) for w in smaller] + [full]


class Pacer:
    """Chooses the size for a time budget from milliseconds per ray, which it measures."""

    def __init__(self, sizes: Sequence[tuple[int, int]], budget: float):
        self.sizes, self.budget = list(sizes), budget
        self._cost: float | None = None
        self._held = self.sizes[0]

    @property
    def cost(self) -> float | None:
        """Milliseconds per ray, a running mean; None before anything was measured."""
        return self._cost

    def measured(self, size: tuple[int, int], rays: int, milliseconds: float) -> None:
        """A picture of this size took so long, with so many rays a pixel in all."""
        cost = milliseconds / (size[0] * size[1] * rays)
        self._cost = cost if self._cost is None else self._cost + SHARE * (cost - self._cost)

    def size(self, rays: int) -> tuple[int, int]:
        """The largest size whose pictures of so many rays a pixel are made within the budget; the
        smallest if none is, or if nothing is known."""
        if self._cost is None:
            return self.sizes[0]
        fits = self.sizes[0]
        for size in self.sizes:
            reserve = RESERVE if size[0] > self._held[0] else 1.0
            if reserve * self._cost * size[0] * size[1] * rays <= self.budget:
                fits = size
        self._held = fits
        return fits
