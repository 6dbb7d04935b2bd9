"""Where the cameras are, and what tells it: poses, lenses, points and matches."""

import dataclasses

import numpy as np
from jaxtyping import Int

from gaussray.prepare.features import Keypoints, MatchingPicture
from gaussray.prepare.overlays import PictureOverlay
from gaussray.prepare.sparse_model import SparseModel


@dataclasses.dataclass(frozen=True, eq=False)
class Placement:
    """What matching and mapping have found.

    Args:
        model: poses, lenses and points of the registered pictures.
        pictures: camera and timestamp of every picture that was matched, by file. Of a camera that
            stands still it is the first timestamp; `keypoints` say which feature is of which.
        keypoints: keypoints by file.
        matches: verified matches by pair of files.
        still: names of the cameras that stand still.
        known: poses and lenses come from a calibration.
        stride: of so many timestamps one is used (`moving_stride`); timestamps of `pictures` and
            `keypoints` count those alone.
        more_instants: `frames.instants` that would find more matches of cameras that stand still; 0
            if there are none, or no further timestamps.
        full_pictures: files of the pictures that have more features than are taken; none where
            MANY_FEATURES are.
        overlays: drawings over the pictures, whose matches were not used.
        strays: files of the pictures whose pose cannot be right (`without_strays`).
        fov_given: the rough field of view is the user's (`poses.fov`).
        rig_untold: the pictures do not tell whether any camera stands still; all are taken to move.
    """

    model: SparseModel
    pictures: dict[str, MatchingPicture]
    keypoints: dict[str, Keypoints]
    matches: dict[tuple[str, str], Int[np.ndarray, "m 2"]]
    still: frozenset[str]
    known: bool
    stride: int = 1
    more_instants: int = 0
    full_pictures: frozenset[str] = frozenset()
    overlays: tuple[PictureOverlay, ...] = ()
    strays: frozenset[str] = frozenset()
    fov_given: bool = False
    rig_untold: bool = False
