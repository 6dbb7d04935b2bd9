"""Lenses as keys of a capture's JSON, and as COLMAP's cameras."""

from typing import Any

import numpy as np
from jaxtyping import Float

from gaussray.capture.formats.colmap_files import COLMAP_MODELS


# COLMAP's model for each choice of poses.model.
MODEL_OF_CHOICE = {
    "pinhole": "SIMPLE_PINHOLE",
    "radial": "SIMPLE_RADIAL",
    "opencv": "OPENCV",
    "opencv_fisheye": "OPENCV_FISHEYE",
}
_PARAMETERS = dict(COLMAP_MODELS.values())

# Angles at which a fisheye's radius is tabulated, 0.1 degrees apart: linear between them, a radius
# is wrong by less than 1e-6 focal lengths.
_ANGLES = 1801

# A lens is the keys of a capture's JSON: camera_model, w, h, fl_x, fl_y, cx, cy and coefficients.
LensKeyValues = dict[str, Any]


def from_colmap(model: str, width: int, height: int, parameters: Any) -> LensKeyValues:
    """The keys of a COLMAP camera.

    Args:
        model: COLMAP's name of the lens model.
        width: columns of the pictures.
        height: rows of the pictures.
        parameters: numbers of the model in COLMAP's order, in pixels but for the coefficients.
    """
    names = _PARAMETERS[model]
    values: LensKeyValues = dict(zip(names, map(float, parameters), strict=True))
    if "f" in values:
        focal = values.pop("f")
        values = {"fl_x": focal, "fl_y": focal, **values}
    return {"camera_model": model, "w": int(width), "h": int(height), **values}


def to_colmap(lens: LensKeyValues) -> tuple[str, list[float]]:
    """COLMAP's model that holds all coefficients of a lens, and its parameters."""
    model = lens["camera_model"]
    if model in ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV"):
        last = [key for key in _PARAMETERS["FULL_OPENCV"][4:] if lens.get(key, 0.0)]
        small = set(last) <= set(_PARAMETERS["OPENCV"][4:])
        model = "PINHOLE" if not last else "OPENCV" if small else "FULL_OPENCV"
    return model, [float(lens.get(key, 0.0)) for key in _PARAMETERS[model]]


def start_focal(model: str, fov: float, width: int, height: int) -> float:
    """Focal length to start from, as a share of the picture's longer side.

    Args:
        model: lens model that is estimated, one of `poses.model`.
        fov: rough horizontal field of view in degrees; 0 takes what is usual: 150 degrees for a
            fisheye, a share of 1.2 for others.
        width: columns of the pictures.
        height: rows of the pictures.
    """
    longer = max(width, height)
    if model == "opencv_fisheye":
        return width / np.radians(fov or 150.0) / longer
    return width / 2 / np.tan(np.radians(fov) / 2) / longer if fov else 1.2


def lens_fov(lens: LensKeyValues) -> float:
    """Angle in degrees across the width of the picture, without distortion."""
    half = lens["w"] / 2 / lens["fl_x"]
    if "FISHEYE" in lens["camera_model"]:
        return float(np.degrees(2 * half))
    return float(np.degrees(2 * np.arctan(half)))


def fisheye_radii(
    lens: LensKeyValues, angle: Float[np.ndarray, " rays"]
) -> Float[np.ndarray, " rays"]:
    """Distances from the principal point, in focal lengths, of rays of an OPENCV_FISHEYE lens.

    Args:
        lens: lens with coefficients k1 to k4.
        angle: angles off the axis in radians.
    """
    powers = angle[:, None] ** np.array([2, 4, 6, 8])
    return angle * (1 + powers @ np.array([lens.get(f"k{i}", 0.0) for i in (1, 2, 3, 4)]))


def fisheye_angles(
    lens: LensKeyValues, radius: Float[np.ndarray, " pixels"]
) -> Float[np.ndarray, " pixels"]:
    """Angles off the axis in radians of an OPENCV_FISHEYE lens, NaN where no ray arrives.

    COLMAP's own rays are wrong beyond 90 degrees.

    Args:
        lens: lens with coefficients k1 to k4.
        radius: distances from the principal point in focal lengths.
    """
    angle = np.linspace(0, np.pi, _ANGLES)
    curve = fisheye_radii(lens, angle)
    falls = np.flatnonzero(np.diff(curve) <= 0)
    rising = slice(0, falls[0] + 1 if len(falls) else None)
    return np.interp(radius, curve[rising], angle[rising], right=np.nan)
