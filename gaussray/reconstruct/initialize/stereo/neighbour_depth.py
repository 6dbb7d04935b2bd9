"""Points of what moves in one picture alone, as far away as what stands still beside it.

One picture of a time says nothing of distances. But what moves stands on something, hangs on
something, or is fastened to it: the nearest of what stands still around a group of moving pixels
is about as far away as the group.
"""

import jax
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.ndimage import binary_dilation, find_objects
from skimage.measure import label

from gaussray.reconstruct.initialize.stereo.points import StereoPoints, no_points
from gaussray.reconstruct.initialize.stereo.views import Channels, StereoViews, rays, unpacked
from gaussray.runtime.stored_programs import kept_jit


# Pixels between a group of moving pixels and what is beside it, and width of the latter.
_GAP, _WIDE = 1, 3
# Of the distances beside a group, the share that is nearer than the group. Single pixels may show
# what floats in the air.
_NEARER = 0.05
# Smaller groups are noise.
_FEWEST = 6
_AROUND = np.ones((3, 3), bool)


def points_beside(
    view: StereoViews,
    moved: Bool[np.ndarray, "h w"],
    distance: Float[np.ndarray, "h w"],
) -> StereoPoints:
    """Points of the moving pixels of a picture, each group at the distance of the nearest of what
    stands still beside it, and before what is behind it.

    Args:
        view: one view, reduced.
        moved: which of its pixels move.
        distance: from the camera to what stands still, along the ray of each pixel, in scene units;
            infinite where nothing is.

    Returns:
        A point for every pixel of a group that has anything beside it, or behind it.
    """
    groups = np.asarray(label(moved, connectivity=2))
    away = np.full(moved.shape, np.inf)
    apart = np.asarray(binary_dilation(moved, _AROUND, _GAP), bool)
    margin = _GAP + _WIDE
    for k, (rows, columns) in enumerate(find_objects(groups), 1):
        part = np.s_[
            max(rows.start - margin, 0) : rows.stop + margin,
            max(columns.start - margin, 0) : columns.stop + margin,
        ]
        own = groups[part] == k
        beside = distance[part][binary_dilation(own, _AROUND, margin) & ~apart[part]]
        beside = beside[np.isfinite(beside)]
        if not len(beside):
            # Before a plain backdrop: a blurred mean of the group is all that stands still.
            beside = distance[part][own & np.isfinite(distance[part])]
        if own.sum() >= _FEWEST and len(beside):
            away[part][own] = np.quantile(beside, _NEARER)
    row, column = np.nonzero(np.isfinite(away))
    if not len(row):
        return no_points()
    away = np.minimum(away, distance)
    ray, color = jax.device_get(_rays_and_colors(view))
    origin, angle = jax.device_get((view.origin, view.angle))
    toward, far = ray[:, row, column].T, away[row, column, None]
    count = len(row)
    return StereoPoints(
        position=(origin + far * toward).astype(np.float32),
        normal=-toward,
        color=np.stack([channel[row, column] for channel in color], axis=1),
        confidence=np.full(count, 0.1, np.float32),
        error=far[:, 0].astype(np.float32),
        scale=(angle * far[:, 0]).astype(np.float32),
    )


@kept_jit
def _rays_and_colors(view: StereoViews) -> tuple[Float[Array, "3 h w"], Channels]:
    """Viewing directions and colours of all pixels of a view; one program."""
    ray = rays(view.lens, view.world_from_camera, view.size, view.factor)
    return ray, unpacked(view.pixel, ray.dtype)[0]
