"""Pictures that have more SIFT features than were taken."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from gaussray.capture.picture_file import picture_size, read_levels
from gaussray.prepare.colmap import pycolmap


# `poses.features` that is recommended where pictures have more of them than are taken.
MANY_FEATURES = 16384
# The least white share of a mask at which a picture may be full.
_LEAST_WHITE = 0.1
# SIFT (vlfeat's, which COLMAP uses) finds features at levels k = 0, 1, ... of an octave, whose own
# scales are 1.6 * 2^((k + 1) / levels) of its pixels, and then moves each by less than 1.5 levels.
_FIRST_SIGMA, _REFINED = 1.6, 1.5


def full_pictures(database: Path, most: int, masks: Path | None = None) -> frozenset[str]:
    """Files of the pictures that have as many features as are taken, and have more.

    COLMAP takes whole levels of scale, the coarse ones first, until they are more than `most`: the
    finest level is among them where nothing was left out (`_finest_scale`).

    Args:
        database: COLMAP database with the features.
        most: the most that were taken. A feature with several directions is one of them, and one
            in a black pixel of a mask, which is then left out, was.
        masks: folder of masks (`extract_features`).
    """
    with pycolmap().Database.open(database) as db:
        return frozenset(
            image.name for image in db.read_all_images() if _is_full(db, image, most, masks)
        )


def _finest_scale() -> float:
    """Pixels below which only the finest level of SIFT has features: a feature's scale may be
    moved by up to `_REFINED` levels from that of its own, and the next level is one above."""
    sift = pycolmap().FeatureExtractionOptions().sift
    own = _FIRST_SIGMA * 2.0 ** (sift.first_octave + 1 / sift.octave_resolution)
    return own * 2.0 ** ((1 - _REFINED) / sift.octave_resolution)


def _has_finest_level(rows: Float[np.ndarray, "n columns"], size: tuple[int, int]) -> bool:
    """Whether features of the finest level are among those of a picture.

    Args:
        rows: keypoints of COLMAP: place, then scale, or the columns of a scaled rotation.
        size: columns and rows of the picture.
    """
    scale = np.hypot(rows[:, 2], rows[:, 4]) if rows.shape[1] == 6 else rows[:, 2]
    # Features of larger pictures are those of a reduced one.
    longest = pycolmap().FeatureExtractionOptions().eff_max_image_size()
    return bool(np.any(scale < max(max(size) / longest, 1.0) * _finest_scale()))


def _is_full(db: Any, image: Any, most: int, masks: Path | None) -> bool:
    count = db.num_keypoints_for_image(image.image_id)
    if count < most * (1.0 if masks is None else _LEAST_WHITE):
        return False
    rows, camera = db.read_keypoints(image.image_id), db.read_camera(image.camera_id)
    if _has_finest_level(rows, (camera.width, camera.height)):
        return False
    distinct = len(np.unique(rows[:, :2], axis=0))
    if distinct >= most or masks is None:
        return distinct >= most
    mask = masks / f"{image.name}.png"
    # The share of the picture that counts.
    return distinct >= most * float(np.mean(read_levels(mask, *picture_size(mask)) > 0))
