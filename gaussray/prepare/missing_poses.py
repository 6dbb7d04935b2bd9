"""Why structure from motion finds no poses, in a sentence with the remedy."""

from pathlib import Path

import numpy as np

from gaussray.prepare.colmap import pycolmap
from gaussray.prepare.features import median_features


# Features of a picture that shows nothing: black, out of focus, a bare wall. A poor picture of 320
# x 240 has some hundred.
_BARE = 30
# Fewest verified matches of the pair with which a reconstruction begins; and those with which one
# may, because COLMAP halves its demand twice.
FIRST_PAIR, FIRST_PAIR_AT_LAST = 50, 12
# Share of the pairs that a homography explains where there may be no parallax; and the observations
# of points, as a share of the matches, below which there is none: those of a camera that only turns
# are 0.2 % at most, those of a flat wall, seen from several places, 40 %.
MOSTLY_FLAT, _EXPLAINED = 0.9, 0.05


def lacks_parallax(database: Path, observations: int) -> bool:
    """Whether homographies explain the pairs of pictures, and hardly any match becomes a point.

    Of two pictures, for which no third one tests the points, a homography alone decides.

    Args:
        database: COLMAP database with verified matches.
        observations: observations of the points of its best reconstruction.
    """
    with pycolmap().Database.open(database) as db:
        untested = db.num_images() == 2
    share, total = flat_pairs(database)
    return share >= MOSTLY_FLAT and (untested or observations < _EXPLAINED * total)


def flat_pairs(database: Path) -> tuple[float, int]:
    """The share of the pairs that a homography explains, and the number of all matches.

    Args:
        database: COLMAP database with verified matches.
    """
    colmap = pycolmap()
    kinds = colmap.TwoViewGeometryConfiguration
    homographies = (kinds.PLANAR, kinds.PANORAMIC, kinds.PLANAR_OR_PANORAMIC)
    with colmap.Database.open(database) as db:
        _, geometries = db.read_two_view_geometries()
    matched = [(g.config, len(g.inlier_matches)) for g in geometries if len(g.inlier_matches)]
    flat = [config in homographies for config, _ in matched]
    total = sum(count for _, count in matched)
    return float(np.mean(flat)) if flat else 0.0, total


def missing_poses_reason(database: Path, still: bool = False) -> str:
    """Why the pictures of a database have no poses or no points.

    Args:
        database: COLMAP database with features and verified matches.
        still: whether pictures hold the features of several timestamps of a camera.
    """
    with pycolmap().Database.open(database) as db:
        images = db.num_images()
    if images < 2:
        return (
            "poses must be estimated from at least two pictures from different places, got a "
            "single picture or a single camera that stands still. Add cameras, or move the camera "
            "(poses.rig=moving says that it does)."
        )
    if (features := median_features(database)) < _BARE:
        return (
            f"the pictures must show texture, got {int(features)} features a picture "
            "(median). Check that they are not black, overexposed or out of focus; "
            "plain walls need posters, or a calibration as poses.calibration=FILE."
        )
    if lacks_parallax(database, 0):
        return (
            "the pictures must show depth from different places, got pictures without parallax. "
            "Either they are taken from one place: move the camera sideways between them, by about "
            "a tenth of the distance of what it shows (turning it or zooming is not enough), and "
            "do not put several cameras in one place. Or all that they show lies in one plane or "
            "far away: put something in front of it, or give a calibration as "
            "poses.calibration=FILE."
        )
    best = best_pair(database)
    if best >= FIRST_PAIR:
        return (
            f"the pictures must tell where their cameras are, got {best} verified matches of the "
            "best pair but no poses that explain them. Give a calibration as "
            "poses.calibration=FILE"
            + (", or try poses.rig=moving frames.rate=1, a pose for each timestamp" * still)
            + ". Cameras should be 5 to 30 degrees apart, seen from what they show: closer ones "
            "have too little parallax, and others too many wrong matches."
        )
    return (
        f"the pictures must share enough matches to find poses, {FIRST_PAIR} of a pair, got {best} "
        "of the best pair that one geometry explains. Cameras must see the same textured things "
        "from less than about 30 degrees apart: add cameras between, or give a calibration as "
        "poses.calibration=FILE."
    )


def best_pair(database: Path) -> int:
    """The number of verified matches of the pair that has most of them."""
    with pycolmap().Database.open(database) as db:
        _, geometries = db.read_two_view_geometries()
    return max((len(geometry.inlier_matches) for geometry in geometries), default=0)
