"""The points that stereo finds."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from gaussray.color import srgb_decode


class StereoPoints(NamedTuple):
    """Points of surfaces, on the host.

    Args:
        position: places in the world.
        normal: unit normals in the world.
        color: sRGB-encoded, in 0..1.
        confidence: 1 minus the matching cost, times the share of the neighbours that confirm the
            point, in 0..1.
        error: standard deviation of the place along the ray, in scene units.
        scale: gap to the neighbouring points, in scene units: the width of a pixel at the point's
            distance, or of the voxel that it stands for.
    """

    position: Float[np.ndarray, "points 3"]
    normal: Float[np.ndarray, "points 3"]
    color: Float[np.ndarray, "points 3"]
    confidence: Float[np.ndarray, " points"]
    error: Float[np.ndarray, " points"]
    scale: Float[np.ndarray, " points"]

    @property
    def light(self) -> Float[np.ndarray, "points 3"]:
        """Linear light of the colours."""
        return srgb_decode(np.clip(self.color, 0, 1).astype(np.float64))


def no_points() -> StereoPoints:
    """The empty set."""
    vector, number = np.zeros((0, 3), np.float32), np.zeros(0, np.float32)
    return StereoPoints(vector, vector, vector, number, number, number)
