"""Whether the pictures tell the focal length, and which one is taken where they do not.

A camera that goes straight on, or sees one plane, explains its pictures with many focal lengths: a
longer one with more distortion, from farther away.
"""

import copy
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gaussray.capture.spread import spread_indices
from gaussray.prepare.colmap import pycolmap
from gaussray.prepare.options import PosesOptions


# Shares of the estimated focal length that are tried instead, and the growth of the median
# reprojection error up to which they explain the pictures as well. Where pictures tell, it grows
# to 1.24 and more (five sets of photographs), where they do not (a phone that goes by), to 1.004.
_TRIED, _AS_WELL = (0.8, 1.25), 1.1
# At most so many pictures are asked.
_ASKED = 50


def expected_focal_lengths(database: Path, options: PosesOptions) -> dict[int, float]:
    """Focal lengths in pixels that are known before any matches, by number of the camera.

    Args:
        database: COLMAP database that lists the pictures, before poses are estimated.
        options: a rough field of view counts for all cameras; else what the files say (EXIF), but
            for fisheyes.
    """
    with pycolmap().Database.open(database) as db:
        cameras = db.read_all_cameras()
    read = options.model != "opencv_fisheye"
    trusted = [one for one in cameras if options.fov or read and one.has_prior_focal_length]
    return {camera.camera_id: camera.mean_focal_length() for camera in trusted}


def settled_focal_length(reconstruction: Any, expected: Mapping[int, float]) -> tuple[Any, str]:
    """A reconstruction whose focal lengths, where the pictures do not tell them, are likely ones.

    These are the expected ones, or, unless all cameras have one, what fits the pictures without
    distortion. They are taken if they explain the pictures as well as what was estimated.

    Args:
        reconstruction: COLMAP reconstruction with at least one point.
        expected: focal lengths in pixels by number of the camera (`expected_focal_lengths`).

    Returns:
        The reconstruction, and what tells its focal lengths: `pictures` (then it is the given one),
        `expected`, or `guess`.
    """
    few = _some_pictures(reconstruction)
    most = _AS_WELL * _adjusted_error(few)
    for share in _TRIED:
        other = copy.deepcopy(few)
        for camera in other.cameras.values():
            _set(camera, camera.focal_length_idxs(), share * camera.mean_focal_length())
        if not _adjusted_error(other, focal=False) <= most:
            return reconstruction, "pictures"
    likely = copy.deepcopy(reconstruction)
    known = all(number in expected for number in likely.cameras)
    for number, camera in likely.cameras.items():
        if known:
            _set(camera, camera.focal_length_idxs(), expected[number])
        elif not camera.model_name.endswith("FISHEYE"):
            _set(camera, camera.extra_params_idxs(), 0.0)
    error = _adjusted_error(likely, focal=not known, distortion=known)
    if error <= _AS_WELL * _adjusted_error(copy.deepcopy(reconstruction)):
        return likely, "expected" if known else "guess"
    return reconstruction, "guess"


def adjusted_reconstruction(reconstruction: Any) -> Any:
    """A copy of a COLMAP reconstruction after bundle adjustment of everything but principal
    points; None of None."""
    if reconstruction is None:
        return None
    free = copy.deepcopy(reconstruction)
    _adjusted_error(free)
    return free


def _some_pictures(reconstruction: Any) -> Any:
    """A copy with at most `_ASKED` pictures, spread over the order of their names."""
    few = copy.deepcopy(reconstruction)
    images = sorted(map(few.image, few.reg_image_ids()), key=lambda image: image.name)
    kept = spread_indices(len(images), _ASKED)
    for k in set(range(len(images))) - set(kept.tolist()):
        few.deregister_frame(images[k].frame_id)
    return few


def _set(camera: Any, places: Sequence[int], value: float) -> None:
    parameters = camera.params
    parameters[list(places)] = value
    camera.params = parameters


def _adjusted_error(reconstruction: Any, focal: bool = True, distortion: bool = True) -> float:
    """Median reprojection error in pixels after bundle adjustment, which changes its argument."""
    colmap = pycolmap()
    options = colmap.BundleAdjustmentOptions()
    options.print_summary = False
    options.refine_focal_length, options.refine_extra_params = focal, distortion
    problem = colmap.BundleAdjustmentConfig()
    for number in reconstruction.reg_image_ids():
        problem.add_image(number)
    problem.fix_gauge(colmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    colmap.create_default_bundle_adjuster(options, problem, reconstruction).solve()
    reconstruction.update_point_3d_errors()
    points = reconstruction.points3D.values()
    errors = [np.full(point.track.length(), point.error) for point in points]
    return float(np.median(np.concatenate(errors))) if errors else np.inf
