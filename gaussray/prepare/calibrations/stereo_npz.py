"""NumPy's .npz files with the results of cv2.stereoCalibrate, or of several cameras by name."""

import zipfile
from pathlib import Path

from gaussray.io.safe.arrays import Damaged, read_npz
from gaussray.prepare.calibrations.known_camera import ALL_KINDS, Calibration
from gaussray.prepare.calibrations.stacked_npz import (
    camera_stack,
    stacked_cameras,
    with_stacked_projections,
)
from gaussray.prepare.calibrations.stereo_pair import (
    has_stereo_lenses,
    has_stereo_pose,
    stereo_cameras,
)
from gaussray.prepare.errors import PrepareError


_REMEDY = (
    "Save it again with numpy.savez(FILE, K1=K1, D1=D1, K2=K2, D2=D2, R=R, T=T), where each is an "
    "array of numbers."
)


def is_stereo_npz(path: Path) -> bool:
    """Whether a file is an .npz archive whose names are those of a stereo calibration."""
    if path.suffix.lower() != ".npz":
        return False
    try:
        with zipfile.ZipFile(path) as archive:
            keys = [name.removesuffix(".npy") for name in archive.namelist()]
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError):
        return False
    return has_stereo_lenses(keys) and has_stereo_pose(keys)


def read_calibration_npz(path: Path) -> Calibration:
    """The cameras of a file: those that it has arrays of (`stacked_cameras`), else the two of a
    stereo calibration, which are fisheyes if the file has `fisheye` in its name and four distortion
    coefficients.

    Raises:
        PrepareError: The file is damaged or holds Python objects, or is no stereo calibration.
    """
    try:
        values = read_npz(path)
    except Damaged as error:
        raise PrepareError(
            f"{error}. It must be an .npz file of plain numbers (no Python objects). {_REMEDY}"
        ) from None
    if not has_stereo_lenses(values):
        values = with_stacked_projections(path, values)
        if camera_stack(values):
            return stacked_cameras(path, values)
    if not has_stereo_lenses(values) and not has_stereo_pose(values):
        raise PrepareError(
            f"{path}: must hold K1, D1, K2, D2, R and T of two cameras, or K, R, T, dist and names "
            f"(or P, 3 x 4) of several, got {', '.join(values)[:200] or 'nothing'}. {_REMEDY} "
            f"{ALL_KINDS}"
        )
    return stereo_cameras(path, values, name=path.name)
