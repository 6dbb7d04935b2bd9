"""Google's immersive light field videos (Broxton et al. 2020): `models.json` and fisheye videos."""

import dataclasses
from pathlib import Path

import jax.numpy as jnp
from jaxtyping import DTypeLike

from gaussray.capture.capture import Capture
from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.poses import axis_angle_turn, opengl_pose
from gaussray.capture.formats.rig import Numbered, numbered_pictures, rig_capture
from gaussray.capture.formats.transforms import json_content, json_if_readable
from gaussray.capture.videos import VIDEO_SUFFIXES, frame_path, read_video
from gaussray.io.safe.limits import within


MODELS_FILE = "models.json"
# The middle of the rig, which its authors and others hold out.
_HELD_OUT = "camera_0001"


def is_immersive(folder: Path) -> bool:
    """Whether a folder holds a models.json that lists cameras."""
    content = json_if_readable(folder / MODELS_FILE)
    first = content[0] if isinstance(content, list) and content else None
    return isinstance(first, dict) and "principal_point" in first


def read_immersive(folder: Path | str, dtype: DTypeLike = jnp.float32) -> Capture:
    """The frames of the videos of the cameras that `models.json` lists.

    Each camera has a `name`, that of its video (`camera_0001.mp4`) or of a folder of numbered
    pictures (`camera_0001/0.png`), `width`, `height`, `focal_length` and `principal_point` in
    pixels, `radial_distortion` (k1, k2 and k3 of an equidistant fisheye: r = f (t + k1 t^3 + k2 t^5
    + k3 t^7), t the angle from the axis), `position`, and `orientation`, world to camera (axis
    times angle; OpenCV's axes). `camera_0001` is held out. Frame i of n is at time i / n.

    Args:
        folder: the folder with `models.json` and the videos.
        dtype: type of the cameras' numbers.

    Raises:
        CaptureError: the file contradicts the format; the message names camera and key.
        FileNotFoundError: `models.json` does not exist.
        OSError: a video is damaged.
    """
    path = Path(folder) / MODELS_FILE
    listed = json_content(path)
    if not isinstance(listed, list) or not listed or not all(isinstance(x, dict) for x in listed):
        raise CaptureError(f"{path}: the file must be a list of at least one camera, each a block.")
    within(path, "the cameras", len(listed), "frames")
    top = Keys(path, {})
    own = [Keys(path, values, k, kind="camera") for k, values in enumerate(listed)]
    pictures = {camera.text("name"): _pictures(path.parent, camera) for camera in own}
    return rig_capture(top, [_camera(camera) for camera in own], pictures, dtype)


def _pictures(folder: Path, camera: Keys) -> Numbered:
    name = camera.text("name")
    camera.inside("name")  # must not lead out of the folder
    for suffix in VIDEO_SUFFIXES:
        path = folder / f"{name}{suffix}"
        if path.is_file():
            frames = range(read_video(path).frames)
            return {i: frame_path(path, i).relative_to(folder).as_posix() for i in frames}
    found = numbered_pictures(folder, (folder / name).glob("*"), r".*/(?P<camera>)(?P<number>\d+)")
    return found.get("", {})


def _camera(own: Keys) -> Keys:
    """The keys of a camera as of a frame in a transforms.json."""
    kind = own.values.get("projection_type", "fisheye")
    if kind != "fisheye":
        raise own.error("projection_type", "fisheye")
    if abs(own.number("pixel_aspect_ratio", 1.0) - 1) > 1e-6:
        raise own.error("pixel_aspect_ratio", "1", "Scale the pictures to square pixels.")
    focal = own.number("focal_length")
    center = own.vector("principal_point", 2)
    radial = own.values.get("radial_distortion")
    radial = own.vector("radial_distortion", len(radial) if isinstance(radial, list) else 3)
    if not 2 <= len(radial) <= 4:
        raise own.error("radial_distortion", "2 to 4 numbers")
    turn, name = axis_angle_turn(own.vector("orientation", 3)).T, own.text("name")
    values = {
        **{"camera_model": "OPENCV_FISHEYE", "w": own.count("width"), "h": own.count("height")},
        **{"fl_x": focal, "fl_y": focal, "cx": center[0], "cy": center[1]},
        **{f"k{i}": k for i, k in enumerate(radial, 1)},
        **{"camera": name, "split": "test" if name == _HELD_OUT else "train"},
        "transform_matrix": opengl_pose(turn, own.vector("position", 3)),
    }
    return dataclasses.replace(own, values=values)
