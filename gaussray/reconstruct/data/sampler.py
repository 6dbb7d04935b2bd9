"""Which tiles a step sees: more of them where pixels move, and where the error is large."""

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
    """The error of the tiles of every camera when they were last drawn.

    It is an exponential mean over all times: 1000 steps draw a tile of one time hardly once, but
    the same tile of a camera as often as there are times. A tile that was never drawn has the
    largest error. Errors given to `note_errors` count after `learn`, so that a block can be drawn
    while the device works on the one before.

    Args:
        camera: number of the fixed viewpoint of each frame.
        tiles: tiles of a picture.
    """

    # Weight of the latest error.
    RATE = 0.3

    def __init__(self, camera: Int[np.ndarray, " frames"], tiles: int):
        self._camera = camera
        self._mean = np.full((int(camera.max()) + 1, tiles), np.nan, np.float32)
        self._told = np.zeros((0, 2), np.int32), np.zeros(0, np.float32)

    def note_errors(self, frame: np.ndarray, tile: np.ndarray, error: np.ndarray) -> None:
        """Take the errors of a block; `learn` must be called before the next `note_errors`.

        Args:
            frame: the frame of each tile that the block drew, of any shape.
            tile: the number of each tile in its frame, of the same shape.
            error: the error of each, at least 0, of the same shape.
        """
        place = np.stack([self._camera[frame.reshape(-1)], tile.reshape(-1)], axis=1)
        self._told = place.astype(np.int32), np.asarray(error, np.float32).reshape(-1)

    def learn(self) -> None:
        """Count the errors of the last block."""
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
        """The errors of the tiles of these frames."""
        known = self._mean[~np.isnan(self._mean)]
        worst = known.max() if known.size else 1.0
        mean = self.seen(frames)
        return np.where(np.isnan(mean), worst, mean)

    def seen(self, frames: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n tiles"]:
        """The errors of the tiles of these frames; NaN of those that were never drawn."""
        return self._mean[self._camera[frames]]

    def state(self) -> TileErrorState:
        """Everything known, to be saved."""
        return TileErrorState(self._mean.copy(), *self._told)

    def restore(self, state: TileErrorState) -> None:
        """Go on from a saved state."""
        self._mean = state.mean.copy()
        self._told = state.place, state.error


class Sampler:
    """Draws the tiles of steps; each step sees one time from all cameras.

    The loss is not divided by the probability of a tile: tiles that are drawn often shall count
    more. Importance weights would keep the loss of uniform draws and lower only the variance of its
    gradient, and that of an absolute difference does not grow with the error.

    Args:
        times: the time of each frame.
        moved: number of moving pixels of each tile.
        visible: tiles that may be drawn, with at least one pixel that is not masked; None for all.
        tiles: tiles that a step draws.
        moving_share: of the tiles that are not drawn by error, the share that is drawn in
            proportion to their moving pixels; the rest is drawn uniformly.
        error: share of the tiles that is drawn in proportion to their errors.
        errors: the errors so far; None: none is drawn by error.

    Raises:
        CaptureError: no tile may be drawn at any time.
    """

    def __init__(
        self,
        times: np.ndarray,
        moved: Integer[np.ndarray, "frames tiles"],
        visible: Bool[np.ndarray, "frames tiles"] | None = None,
        *,
        tiles: int,
        moving_share: float,
        error: float = 0.0,
        errors: TileErrors | None = None,
    ):
        self.times = np.unique(times)
        self._own = [np.flatnonzero(times == t) for t in self.times]
        self._moved, self._visible = moved, visible
        self._tiles, self._moving_share = tiles, moving_share
        self._error, self._errors = error, errors
        seen = [visible is None or bool(visible[own].any()) for own in self._own]
        self.instants = np.flatnonzero(seen)
        if not len(self.instants):
            raise CaptureError(
                "mask_path: the masks leave no pixel of any training view. Masks are white where a "
                "pixel counts; invert them if they mark what is to be ignored, or rename the "
                "folder masks/ to use all pixels."
            )

    def see_moved(self, moved: Integer[np.ndarray, "frames tiles"]) -> None:
        """Draw by these numbers of moving pixels from now on."""
        self._moved = moved

    def draw(
        self, instants: Int[np.ndarray, " steps"], dice: np.random.Generator
    ) -> tuple[Int[np.ndarray, "steps tiles"], Int[np.ndarray, "steps tiles"]]:
        """Frame and tile of every tile that some steps draw.

        Draws are stratified: of n, one falls into each n-th part of the tiles' probability, laid
        out camera after camera and row after row. So they are spread over the pictures, and a tile
        of probability p is drawn n p times on average and less than n p + 2 times.

        Args:
            instants: the time of each step: its index in `self.times`, one of `self.instants`.
            dice: the source of random numbers.
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
        moved = self._moved[own] * visible
        if self._moving_share and moved.any():
            level = (1 - self._moving_share) * level + self._moving_share * _cumulative(moved)
        if self._error and self._errors is not None:
            wrong = self._errors.of(own) * visible
            if wrong.any():
                level = (1 - self._error) * level + self._error * _cumulative(wrong)
        return level


def _cumulative(weight: np.ndarray) -> Float[np.ndarray, " tiles"]:
    total = np.cumsum(weight, dtype=np.float64)
    return total / total[-1]
