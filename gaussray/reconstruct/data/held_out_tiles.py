"""Which tiles no training step draws, so that they can tell when a fit no longer improves."""

from collections.abc import Callable

import jax
import numpy as np
from jaxtyping import Bool, Int

from gaussray.capture.spread import spread_indices
from gaussray.reconstruct.data.batches import Batch, gather
from gaussray.reconstruct.data.pictures import Footage


# Says which tiles no step draws, of the pictures, a share of them and a seed.
HoldOut = Callable[[Footage, float, int], Bool[np.ndarray, "frames tiles"]]

# Captures of fewer tiles have none to spare.
_LEAST = 500
# A trial holds out as many tiles of a small capture as 5 % of 500 are, but a fifth at most: of the
# rest, short fits must still learn the scene.
_TRIAL_LEAST, _TRIAL_SHARE = 25, 0.2
# Times whose held-out tiles are looked at, at most.
_MOST = 32


def held_out_tiles(footage: Footage, share: float, seed: int) -> Bool[np.ndarray, "frames tiles"]:
    """Which tiles are held out: some at random, without those that are masked as a whole.

    Args:
        footage: the training pictures; of fewer than _LEAST tiles none is held out.
        share: share of all tiles that are drawn, in [0, 1].
        seed: seed of the draw.
    """
    shape = footage.pixel.shape[:2]
    held = np.zeros(shape, bool)
    count = round(share * held.size) if held.size >= _LEAST else 0
    chosen = np.random.default_rng([seed, 1]).permutation(held.size)[:count]
    held.reshape(-1)[chosen] = True
    visible = footage.visible_tiles()
    return held if visible is None else held & visible


def trial_tiles(footage: Footage, share: float, seed: int) -> Bool[np.ndarray, "frames tiles"]:
    """Which tiles short fits leave out that tell what helps a capture; also of small captures.

    At least _TRIAL_LEAST of the tiles that are not masked as a whole are held out, but at most a
    fifth of them where the share is smaller: none of fewer than five.

    Args:
        footage: the training pictures.
        share: share of the tiles that are drawn, in [0, 1].
        seed: seed of the draw.
    """
    visible = footage.visible_tiles()
    shape = footage.pixel.shape[:2]
    seen = np.flatnonzero(np.ones(shape, bool) if visible is None else visible)
    least = min(_TRIAL_LEAST, int(_TRIAL_SHARE * len(seen)))
    count = max(round(share * len(seen)), least)
    held = np.zeros(shape, bool)
    held.reshape(-1)[np.random.default_rng([seed, 1]).permutation(seen)[:count]] = True
    return held


def held_out_batches(
    footage: Footage, held: Bool[np.ndarray, "frames tiles"], tiles: int
) -> list[Batch]:
    """The held-out tiles in batches of one time each.

    The last tiles of a time that fill no batch are left out, but each time has at least one batch
    (which may hold a tile twice).

    Args:
        footage: the training pictures; of more than _MOST times, so many, evenly spread, are used.
        held: which tiles are held out (`held_out_tiles`).
        tiles: tiles of a batch: as many as a training step draws.
    """
    times = np.unique(footage.times[held.any(axis=1)])
    times = times[spread_indices(len(times), _MOST)]
    return [
        batch for time in times for batch in _batches_of_time(footage, held, tiles, float(time))
    ]


def _batches_of_time(
    footage: Footage, held: Bool[np.ndarray, "frames tiles"], tiles: int, time: float
) -> list[Batch]:
    now = footage.times == footage.times.dtype.type(time)
    frame, tile = (x.astype(np.int32) for x in np.nonzero(held & now[:, None]))
    # Neighbours together would need longer lists than the tiles of a step.
    order = np.random.default_rng(0).permutation(len(frame))
    frame, tile = frame[order], tile[order]
    count = max(len(frame) // tiles, 1) * tiles
    frame, tile = np.resize(frame, count), np.resize(tile, count)

    def batch(rows: Int[np.ndarray, " tiles"]) -> Batch:
        when = np.array([time], footage.times.dtype)
        several = gather(footage, frame[rows][None], tile[rows][None], when)
        return jax.tree.map(lambda x: x[0], several)

    return [batch(rows) for rows in np.arange(count).reshape(-1, tiles)]
