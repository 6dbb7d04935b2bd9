"""An even share of many points: one per voxel, in voxels as fine as the pictures are there."""

import numpy as np
from jaxtyping import Float, Int

from gaussray.reconstruct.initialize.stereo.points import StereoPoints


def voxels(
    position: Float[np.ndarray, "points 3"], scale: Float[np.ndarray, " points"], size: float
) -> Int[np.ndarray, " points"]:
    """Number of the voxel that holds each point; far surfaces have larger voxels.

    Args:
        position: places in the world.
        scale: gap between neighbouring points at each, in scene units (`StereoPoints.scale`).
        size: width of a voxel, in scales of its points rounded to powers of two.
    """
    return np.unique(_keys(position, _octaves(scale), size), return_inverse=True)[1].reshape(-1)


def _octaves(scale):
    """The power of two that is nearest to each scale."""
    return np.round(np.log2(np.maximum(scale, 1e-30)))


def _keys(position, octave, size):
    """A number for each point's voxel."""
    place = np.floor(position / (size * np.exp2(octave))[:, None]).astype(np.int64)
    # A hash: two voxels that share a number cost one point of thousands.
    primes = np.array([73856093, 19349663, 83492791], np.int64)
    return place @ primes ^ octave.astype(np.int64) * 2654435761


def _number(keys):
    """How many different keys there are. Sorting alone is much faster than `numpy.unique`."""
    ordered = np.sort(keys)
    return 1 + np.count_nonzero(ordered[1:] != ordered[:-1])


def evenly(points: StereoPoints, count: int) -> StereoPoints:
    """An even share of the points: one per voxel, the mean of its points weighted by confidence.

    Args:
        points: the points.
        count: about how many to keep: voxels have the size that leaves so many. No more than these
            are returned as they are.
    """
    if len(points.position) <= count:
        return points
    # Of surfaces, the number of voxels falls with the square of their size.
    size, octave = 1.0, _octaves(points.scale)
    for _ in range(6):
        ratio = _number(_keys(points.position, octave, size)) / count
        if 0.95 < ratio < 1.05:
            break
        size *= np.sqrt(ratio)
    label = voxels(points.position, points.scale, size)
    weight = np.maximum(points.confidence, 1e-6).astype(np.float64)
    total = np.bincount(label, weight)

    def mean(value: np.ndarray) -> np.ndarray:
        columns = value.reshape(len(value), -1)
        means = [np.bincount(label, weight * column) / total for column in columns.T]
        return np.stack(means, axis=-1).reshape(-1, *value.shape[1:]).astype(value.dtype)

    merged = {name: mean(getattr(points, name)) for name in points._fields}
    length = np.linalg.norm(merged["normal"], axis=1, keepdims=True)
    merged["normal"] = merged["normal"] / np.maximum(length, 1e-12)
    # A voxel's point stands for all of it.
    merged["scale"] = merged["scale"] * size
    return StereoPoints(**merged)
