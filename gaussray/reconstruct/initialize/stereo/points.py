"""The points that stereo finds."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class StereoPoints(NamedTuple):
    """Points of surfaces, on the host: place and unit normal in the world, sRGB-encoded colour
    (0..1), how sure each is (0..1: the share of a cost of 0 and of many views), the standard
    deviation of its place along the ray, and the gap to its neighbours that its pixel spans."""

    position: Float[np.ndarray, "points 3"]
    normal: Float[np.ndarray, "points 3"]
    color: Float[np.ndarray, "points 3"]
    confidence: Float[np.ndarray, " points"]
    error: Float[np.ndarray, " points"]
    scale: Float[np.ndarray, " points"]


def no_points() -> StereoPoints:
    """The empty set."""
    vector, number = np.zeros((0, 3), np.float32), np.zeros(0, np.float32)
    return StereoPoints(vector, vector, vector, number, number, number)
