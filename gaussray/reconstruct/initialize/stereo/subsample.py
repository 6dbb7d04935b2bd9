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
    octave = np.round(np.log2(np.maximum(scale, 1e-30)))
    place = np.floor(position / (size * 2.0**octave)[:, None]).astype(np.int64)
    # A hash: two voxels that share a number cost one point of thousands.
    primes = np.array([73856093, 19349663, 83492791], np.int64)
    key = (place * primes[None]).sum(axis=1) ^ (octave.astype(np.int64) * 2654435761)
    return np.unique(key, return_inverse=True)[1].reshape(-1)


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
    size = 1.0
    label = voxels(points.position, points.scale, size)
    for _ in range(6):
        ratio = (label.max() + 1) / count
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
