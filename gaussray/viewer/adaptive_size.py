"""Preview size: the largest picture that is rendered within a time budget."""

import math
from collections.abc import Sequence


# Preview widths in pixels. Few, because each size is compiled.
PREVIEW_WIDTHS = (64, 96, 128, 192, 256, 384, 512, 768, 1024, 1536, 2048, 3072, 4096)
# Weight of a new measurement in the running mean, and the factor by which a larger size must be
# faster than the budget before it is used, so that sizes do not flicker.
SMOOTHING, RESERVE = 0.3, 1.3
# Assumed share of the first picture's time that does not depend on its size.
FIXED_SHARE = 0.5


def preview_sizes(full: tuple[int, int]) -> list[tuple[int, int]]:
    """Width and height of previews, smallest first, with the aspect of the full picture, which is
    the last."""
    width, height = full
    smaller = [w for w in PREVIEW_WIDTHS if w < width]
    return [(w, max(round(w * height / width), 1)) for w in smaller] + [full]


class SizeController:
    """Chooses the preview size for a time budget from measured render times.

    A picture of n rays takes a + b n milliseconds: a for the Gaussians, b for each ray. The
    controller keeps a running mean for each n and predicts other sizes by the line through the two
    nearest. After a single measurement, a is assumed to be `FIXED_SHARE` of it.

    Args:
        sizes: width and height of the possible previews, smallest first.
        budget: milliseconds per picture.
    """

    def __init__(self, sizes: Sequence[tuple[int, int]], budget: float):
        self.sizes, self.budget = list(sizes), budget
        self._mean: dict[int, float] = {}
        self._current = self.sizes[0]

    def record(self, size: tuple[int, int], rays: int, milliseconds: float) -> None:
        """Record how long a preview took.

        Args:
            size: its width and height in pixels.
            rays: rays per pixel; of two pictures, the sum of theirs.
            milliseconds: duration of all its stages.
        """
        count = size[0] * size[1] * rays
        old = self._mean.get(count, milliseconds)
        self._mean[count] = old + SMOOTHING * (milliseconds - old)
        # A slow phase (another program compiles) slows down all sizes alike.
        ratio = self._mean[count] / old if old else 1.0
        self._mean = {n: t if n == count else ratio * t for n, t in self._mean.items()}

    def milliseconds(self, count: int) -> float | None:
        """Predicted time of a picture of `count` rays; None before the first measurement."""
        if not self._mean:
            return None
        near = sorted(self._mean, key=lambda n: abs(math.log(n / count)))
        first = self._mean[near[0]]
        if len(near) == 1:
            slope = (1 - FIXED_SHARE) * first / near[0]
        else:
            slope = (self._mean[near[1]] - first) / (near[1] - near[0])
        # Neither the fixed nor the per-ray time is negative.
        slope = min(max(slope, 0.0), first / near[0])
        return first + slope * (count - near[0])

    def size(self, rays: int) -> tuple[int, int]:
        """The largest size predicted to fit the budget with `rays` rays per pixel; the smallest if
        none fits or nothing has been measured."""
        fits = self.sizes[0]
        for size in self.sizes:
            reserve = RESERVE if size[0] > self._current[0] else 1.0
            predicted = self.milliseconds(size[0] * size[1] * rays)
            if predicted is not None and reserve * predicted <= self.budget:
                fits = size
        self._current = fits
        return fits
