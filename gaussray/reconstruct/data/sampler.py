"""Which tiles a step looks at: more of them where things move, and where the error is."""

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int, Integer

from gaussray.capture.errors import CaptureError


class TileErrorState(eqx.Module):
    """What a `TileErrors` knows: the `mean` error of the tiles of every camera (NaN where none was
    drawn yet), and the errors of the last block that are not in it yet: camera and tile (`place`)
    and `error`."""

    mean: Float[np.ndarray, "cameras tiles"]
    place: Int[np.ndarray, "drawn 2"]
    error: Float[np.ndarray, " drawn"]


class TileErrors:
    """How wrong the tiles of every camera were when they were last drawn.

    A tile's error is the exponential mean of what was told of it at any instant: a training of
    1000 steps draws a tile of one instant hardly once, but that of a camera as often as there are
    instants. What was never drawn counts as the worst. What is told becomes known with `learn`
    alone, so that a block may be drawn while the one before is at work.
    """

    # What the latest error counts for.
    RATE = 0.3

    def __init__(self, camera: Int[np.ndarray, " frames"], tiles: int):
        self._camera = camera
        self._mean = np.full((int(camera.max()) + 1, tiles), np.nan, np.float32)
        self._told = np.zeros((0, 2), np.int32), np.zeros(0, np.float32)

    def tell(self, frame: np.ndarray, tile: np.ndarray, error: np.ndarray) -> None:
        """The errors of a block; they must be learned before the next are told."""
        place = np.stack([self._camera[frame.reshape(-1)], tile.reshape(-1)], axis=1)
        self._told = place.astype(np.int32), np.asarray(error, np.float32).reshape(-1)

    def learn(self) -> None:
        """Take into account what was told."""
        if not len(self._told[1]):
            return
        (camera, tile), error = self._told[0].T, self._told[1]
        total, count = np.zeros_like(self._mean), np.zeros_like(self._mean)
        np.add.at(total, (camera, tile), error)
        np.add.at(count, (camera, tile), 1)
        new = count > 0
        block = total[new] / count[new]
        before = np.where(np.isnan(self._mean[new]), block, self._mean[new])
        self._mean[new] = block + (1 - self.RATE) ** count[new] * (before - block)
        self._told = self._told[0][:0], error[:0]

    def of(self, frames: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n tiles"]:
        """The errors known, of the tiles of these frames."""
        known = self._mean[~np.isnan(self._mean)]
        worst = known.max() if known.size else 1.0
        mean = self._mean[self._camera[frames]]
        return np.where(np.isnan(mean), worst, mean)

    def state(self) -> TileErrorState:
        """Everything known, to be saved."""
        return TileErrorState(self._mean.copy(), *self._told)

    def restore(self, state: TileErrorState) -> None:
        """Go on from a saved state."""
        self._mean = state.mean.copy()
        self._told = state.place, state.error


class Sampler:
    """Draws the tiles of steps; each sees one instant from all cameras. Same dice, same tiles.

    Of an instant's tiles a share `error` is drawn in proportion to their errors; of the others a
    share `balance` in proportion to the pixels that move, the rest evenly. Only tiles that are
    `visible`, those of which any pixel counts, are drawn at all.

    What is drawn often weighs much in the loss, which is the purpose: nothing is divided by its
    probability again. Importance weights would keep the loss that of even draws and only lower the
    noise of its gradient, where that is as uneven as the draws; the gradient of an absolute
    difference does not grow with it.
    """

    def __init__(
        self,
        times: np.ndarray,
        moved: Integer[np.ndarray, "frames tiles"],
        visible: Bool[np.ndarray, "frames tiles"] | None = None,
        *,
        tiles: int,
        balance: float,
        error: float = 0.0,
        errors: TileErrors | None = None,
    ):
        self.times = np.unique(times)
        self._own = [np.flatnonzero(times == t) for t in self.times]
        self._moved, self._visible = moved, visible
        self._tiles, self._balance = tiles, balance
        self._error, self._errors = error, errors
        seen = [visible is None or bool(visible[own].any()) for own in self._own]
        self.instants = np.flatnonzero(seen)
        if not len(self.instants):
            raise CaptureError(
                "mask_path: the masks leave no pixel of any training view. Masks are white where a "
                "pixel counts; invert them if they mark what is to be ignored."
            )

    def draw(
        self, instants: Int[np.ndarray, " steps"], dice: np.random.Generator
    ) -> tuple[Int[np.ndarray, "steps tiles"], Int[np.ndarray, "steps tiles"]]:
        """Frame and tile of every bundle, for steps at the given instants (indices of `times`, of
        those in `instants`).

        Draws are stratified: of n, one falls into each n-th part of the tiles' probability, laid
        out camera after camera and row after row. So they are spread over the pictures, and a tile
        of probability p is drawn n p times on average and less than n p + 2 times.
        """
        count = self._moved.shape[1]
        frame = np.empty((len(instants), self._tiles), np.int32)
        tile = np.empty_like(frame)
        u = dice.random(frame.shape)
        level = (np.arange(self._tiles)[None] + u) / self._tiles
        for instant in np.unique(instants):
            rows, total = instants == instant, self._levels(int(instant))
            # Rounding must not lead beyond the last tile.
            wanted = np.minimum(level[rows], np.nextafter(total[-1], 0))
            place = np.searchsorted(total, wanted, side="right")
            frame[rows], tile[rows] = self._own[instant][place // count], place % count
        return frame, tile

    def _levels(self, instant: int) -> Float[np.ndarray, " tiles"]:
        """Cumulative probability of the tiles of all cameras at an instant."""
        own = self._own[instant]
        visible = np.ones((1, 1)) if self._visible is None else self._visible[own]
        level = _cumulative(np.broadcast_to(visible, (len(own), self._moved.shape[1])))
        moved = self._moved[own]
        if self._balance and moved.any():
            level = (1 - self._balance) * level + self._balance * _cumulative(moved)
        if self._error and self._errors is not None:
            wrong = self._errors.of(own) * visible
            if wrong.any():
                level = (1 - self._error) * level + self._error * _cumulative(wrong)
        return level


def _cumulative(weight: np.ndarray) -> Float[np.ndarray, " tiles"]:
    total = np.cumsum(weight, dtype=np.float64)
    return total / total[-1]
