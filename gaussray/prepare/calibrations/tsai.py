"""Files of Tsai's camera model: `<Camera>` with Geometry, Intrinsic and Extrinsic, one camera each.

EPFL's CVLAB (Terrace, Campus, Laboratory), PETS 2009 and ETISEO write them. The parameters are
those of Willson's implementation:

    (x, y, z) = R X + t                    world to camera; x right, y down, z forward
    R = Rz(rz) Ry(ry) Rx(rx)               radians
    Xu = focal x / z,  Yu = focal y / z    on the sensor, in the unit of focal (mm)
    Xd (1 + kappa1 (Xd^2 + Yd^2)) = Xu     and so for y: distorted to undistorted
    u = cx + sx Xd / dpx,  v = cy + Yd / dpy

What was verified: these are the formulas of ETISEO's own code. Of the twelve orders and signs of
three angles, this one alone makes the four files of Terrace agree: the cameras are 2.00 to 2.11 m
above the plane z = 0, and their optical axes pass within 0.15 m of one point, 6 to 8 m before them
and 0.28 m above that plane (the next best order: 0.53 m, with a camera below it). Lines of that
plane, drawn into the four pictures, follow the joints of the terrace's slabs and its walls. That a
whole u is the middle of a pixel is assumed: the files do not tell half a pixel.
"""

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from gaussray.io.safe.files import parse_xml, read_text
from gaussray.prepare.calibrations.known_camera import KnownCamera, opencv_camera
from gaussray.prepare.errors import PrepareError
from gaussray.runtime.output import first_of
from gaussray.runtime.progress import say


# OpenCV's coefficients may be off by so many pixels anywhere in the picture.
MOST_OFF = 0.05
# Counts of coefficients of the numerator and the denominator that are tried, and radii.
_ORDERS, _RADII = ((0, 0), (1, 0), (2, 0), (3, 0), (3, 3)), 1000
# A file that is larger is of something else.
_LARGEST = 100_000
# dpx and dx ncx / nfx may differ by this share.
_SAME = 1e-3
_PARTS = {
    "Geometry": ("width", "height", "dpx", "dpy"),
    "Intrinsic": ("focal", "kappa1", "cx", "cy", "sx"),
    "Extrinsic": ("tx", "ty", "tz", "rx", "ry", "rz"),
}
_REMEDY = (
    "A camera has <Geometry width height dpx dpy>, <Intrinsic focal kappa1 cx cy sx> and "
    "<Extrinsic tx ty tz rx ry rz>."
)


class TsaiCamera(NamedTuple):
    """A camera, and how many pixels its distortion is off at most from that of its file."""

    camera: KnownCamera
    off: float


def is_tsai(path: Path) -> bool:
    """Whether a file is of one camera of Tsai's model; it may lack numbers."""
    if path.suffix.lower() != ".xml" or not path.is_file() or path.stat().st_size > _LARGEST:
        return False
    try:
        root = parse_xml(path, read_text(path))
    except (ValueError, OSError):
        return False
    return root.tag == "Camera" and sum(root.find(part) is not None for part in _PARTS) > 1


def read_tsai(path: Path, name: str) -> TsaiCamera:
    """The camera of a file, in the unit of its tx, ty and tz.

    Args:
        path: the file (`is_tsai`).
        name: name of the camera.

    Raises:
        PrepareError: A number is missing or wrong, or the distortion turns back within the picture
            or cannot be written with OpenCV's coefficients within MOST_OFF pixels.
    """
    values = _numbers(path, parse_xml(path, read_text(path)))
    scale = np.array([values["sx"] / values["dpx"], 1 / values["dpy"]])
    focal, centre = values["focal"], np.array([values["cx"], values["cy"]])
    size = np.array([values["width"], values["height"]])
    corners = np.array([[-0.5, -0.5], [-0.5, size[1] - 0.5], [size[0] - 0.5, -0.5], size - 0.5])
    # The farthest corner from the axis, in focal lengths, as it is in the picture.
    corner = float(np.linalg.norm((corners - centre) / scale, axis=1).max()) / focal
    distortion, off = opencv_distortion(path, values["kappa1"] * focal**2, corner,
                                        focal * float(scale.max()))  # fmt: skip
    matrix = np.diag([*(focal * scale), 1.0])
    matrix[:2, 2] = centre
    # Turns about the world's fixed axes, first about x.
    turn = Rotation.from_euler("xyz", [values[key] for key in ("rx", "ry", "rz")]).as_matrix()
    pose = np.column_stack([turn, [values[key] for key in ("tx", "ty", "tz")]])
    sides = (values["width"], values["height"])
    return TsaiCamera(opencv_camera(path, name, matrix, distortion, pose, sides), off)


def tell_tsai(where: object, cameras: Mapping[str, TsaiCamera]) -> None:
    """Print how the parameters of Tsai's cameras are taken.

    Args:
        where: the file or folder.
        cameras: the cameras by name; nothing is printed if there are none.
    """
    if cameras:
        worst = max(one.off for one in cameras.values())
        say(
            f"{where}: {first_of(list(cameras))}: Tsai's parameters; R = Rz Ry Rx takes world to "
            f"camera, kappa1 becomes OpenCV's coefficients (at most {worst:.2g} pixels off), and "
            "the unit is that of tx, ty and tz, the millimetre in EPFL's and PETS's files."
        )


def opencv_distortion(
    where: object, kappa: float, corner: float, focal: float
) -> tuple[Float[np.ndarray, " n"], float]:
    """OpenCV's coefficients of the inverse of ru = rd (1 + kappa rd^2), and by how many pixels they
    are off at most.

    They are a fit of rd to ru (1 + k1 ru^2 + k2 ru^4 + k3 ru^6), with as few coefficients as do; if
    these three do not, of that divided by 1 + k4 ru^2 + k5 ru^4 + k6 ru^6. Without distortion all
    are 0.

    Args:
        where: the file, for messages.
        kappa: coefficient for radii in focal lengths.
        corner: largest radius rd in the picture, in focal lengths.
        focal: focal length in pixels, which errors are multiplied with.

    Raises:
        PrepareError: ru falls before the largest radius, or no fit is within MOST_OFF pixels.
    """
    if not 1 + 3 * kappa * corner**2 > 0:
        raise PrepareError(
            f"{where}: kappa1 must keep points of the picture apart, but towards its corners "
            "distortion turns back. Is kappa1 in 1/mm^2, and dpx and dpy in mm? Calibrate it again."
        )
    # Denser towards the corner, where an error of a fit is largest.
    distorted = corner * np.sin(np.linspace(0, np.pi / 2, _RADII)[1:])
    straight = distorted * (1 + kappa * distorted**2)
    share, best = distorted / straight, np.inf
    for above, below in _ORDERS:
        # Powers of a radius from 0 to 1, for the sake of small errors of rounding.
        powers = (straight / straight[-1])[:, None] ** (2 * np.arange(1, 4))
        columns = np.hstack([powers[:, :above], -share[:, None] * powers[:, :below]])
        weighted = columns * straight[:, None], (share - 1) * straight
        found = np.linalg.lstsq(*weighted, rcond=None)[0]
        under = 1 + powers[:, :below] @ found[above:]
        fitted = straight * (1 + powers[:, :above] @ found[:above]) / under
        rises = under.min() > 0 and np.diff(fitted).min(initial=1) > 0
        off = focal * float(np.abs(fitted - distorted).max())
        best = min(best, off)
        if rises and off <= MOST_OFF:
            unit = straight[-1] ** (2.0 * np.arange(1, 4))
            k = np.zeros(6)
            k[:above], k[3 : 3 + below] = found[:above] / unit[:above], found[above:] / unit[:below]
            return np.array([k[0], k[1], 0.0, 0.0, *k[2:]]), off
    raise PrepareError(
        f"{where}: OpenCV's coefficients must follow Tsai's distortion within {MOST_OFF:g} pixels, "
        f'got {best:.2g}. Remove the distortion from the pictures, and write kappa1="0".'
    )


def _numbers(path: Path, root: ElementTree.Element) -> dict[str, float]:
    """The numbers of a file by their keys; those that make no camera are refused."""
    text = {key: value for part in _PARTS for found in root.findall(part)
            for key, value in found.attrib.items()}  # fmt: skip
    values: dict[str, float] = {}
    for key, value in text.items():
        try:
            values[key] = float(value)
        except ValueError:
            values[key] = np.nan
    for cell, (said, factors) in _effective_sizes(values).items():
        if cell not in text:
            values[cell] = said
        elif not abs(values[cell] - said) <= _SAME * abs(said):
            say(
                f"{path}: {cell}={text[cell]} is taken, and not the {said:.6g} that {factors} make."
            )
    wanted = [key for keys in _PARTS.values() for key in keys]
    if missing := [key for key in wanted if not np.isfinite(values.get(key, np.nan))]:
        got = ", ".join(
            f"{key}={text[key][:40]}" if key in text else f"no {key}" for key in missing
        )
        raise PrepareError(f"{path}: must have a number for each parameter, got {got}. {_REMEDY}")
    positive = ("width", "height", "dpx", "dpy", "focal", "sx")
    if wrong := [key for key in positive if not values[key] > 0]:
        raise PrepareError(
            f"{path}: {wrong[0]} must be above 0, got {values[wrong[0]]:g}. Correct it."
        )
    return values


def _effective_sizes(values: Mapping[str, float]) -> dict[str, tuple[float, str]]:
    """The sides of a pixel that the sensor's elements make, dx ncx / nfx in a row and dy in a
    column, and the keys that say them; those that are not said are left out."""
    known = {key: value for key, value in values.items() if np.isfinite(value) and value > 0}
    sizes: dict[str, tuple[float, str]] = {}
    if {"dx", "ncx", "nfx"} <= known.keys():
        sizes["dpx"] = (known["dx"] * (known["ncx"] / known["nfx"]), "dx ncx nfx")
    if "dy" in known:
        sizes["dpy"] = (known["dy"], "dy")
    return sizes
