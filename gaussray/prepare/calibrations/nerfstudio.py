"""transforms.json of nerfstudio and instant-ngp, and Metashape's XML: the camera of each frame."""

from pathlib import Path, PurePosixPath

import numpy as np

from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.metashape import metashape_frames
from gaussray.capture.formats.transforms import frames_of, read_document
from gaussray.geometry import BLENDER_AXES
from gaussray.prepare.calibrations.known_camera import KnownCamera
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.lens_models import LensKeyValues


_MODELS = ("PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV")
_COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")


def read_nerfstudio(path: Path) -> list[KnownCamera]:
    """The camera of the first frame of each name: `camera` of the frame, else the folder of its
    picture if pictures lie in several folders, else the picture's own name.

    Raises:
        PrepareError: A frame's camera model has no counterpart in COLMAP.
    """
    return _cameras_of(frames_of(read_document(path)))


def read_metashape_cameras(path: Path) -> list[KnownCamera]:
    """The cameras of an XML file of Metashape, each called by its label without suffix.

    Raises:
        CaptureError: The file contradicts the format, or a camera is spherical, which has no
            counterpart in COLMAP.
    """
    return _cameras_of(metashape_frames(path, {}))


def _cameras_of(frames: list[Keys]) -> list[KnownCamera]:
    parents = {PurePosixPath(frame.text("file_path")).parent for frame in frames}
    cameras: dict[str, KnownCamera] = {}
    for frame in frames:
        picture = PurePosixPath(frame.text("file_path"))
        name = frame.values.get("camera")
        if name is None:
            name = picture.parent.name if len(parents) > 1 else picture.stem
        cameras.setdefault(str(name), KnownCamera(str(name), frame_lens(frame), _pose(frame)))
    return list(cameras.values())


def frame_lens(frame: Keys) -> LensKeyValues:
    """The lens of a frame, or of a file that has its keys at the top.

    Raises:
        CaptureError: A key is missing or no number.
        PrepareError: The camera model has no counterpart in COLMAP.
    """
    model = frame.choice("camera_model", (*_MODELS, "OPENCV_FISHEYE"), "PINHOLE")
    if frame.has("lens"):
        raise PrepareError(
            f"{frame.where}: must have no lens block to triangulate with, got one. Give "
            f"camera_model as one of {', '.join(_MODELS)} or OPENCV_FISHEYE instead."
        )
    width, height = frame.count("w"), frame.count("h")
    if frame.has("fl_x"):
        focal = frame.number("fl_x")
    else:
        focal = width / 2 / np.tan(frame.number("camera_angle_x") / 2)
    values = {
        **{"camera_model": model, "w": width, "h": height},
        **{"fl_x": float(focal), "fl_y": float(frame.number("fl_y", focal))},
        **{"cx": frame.number("cx", width / 2), "cy": frame.number("cy", height / 2)},
    }
    return values | {key: frame.number(key, 0.0) for key in _COEFFICIENTS if frame.has(key)}


def _pose(frame: Keys) -> np.ndarray:
    world_from_camera = np.array(frame.pose())
    rotation = (world_from_camera[:, :3] * np.array(BLENDER_AXES)).T
    return np.column_stack([rotation, -rotation @ world_from_camera[:, 3]])
