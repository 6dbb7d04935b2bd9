"""The capture's cameras and points, drawn over the picture in the viewer."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from gaussray.capture.capture import View
from gaussray.capture.open import FORMATS, format_of
from gaussray.color import srgb_encode
from gaussray.scene.harmonics import C0
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import Clip, segments_of
from gaussray.viewer.viewpoint import Viewpoint, horizontal_fov, viewpoint_of


# Points sent to a browser, at most.
MAX_POINTS = 50_000


class CameraMarker(NamedTuple):
    """A camera of the capture: name, first viewpoint, vertical field of view (radians), aspect
    (width / height), and whether it was held out from training."""

    name: str
    viewpoint: Viewpoint
    fov: float
    aspect: float
    held_out: bool


class Overlay(NamedTuple):
    """Camera markers, points and their sRGB colours, and the distance of the scene from the first
    camera, which scales what is drawn."""

    camera_markers: list[CameraMarker]
    position: Float[np.ndarray, "points 3"]
    color: UInt8[np.ndarray, "points 3"]
    scale: float


def camera_markers(views: Sequence[View]) -> list[CameraMarker]:
    """One marker per camera. A lens that is not a pinhole gets a frustum of 65 degrees."""
    first = {view.camera_name: view for view in reversed(views)}
    result = []
    for name, view in sorted(first.items()):
        aspect = view.width / view.height
        fov = 2 * math.atan(math.tan(math.radians(horizontal_fov(view.camera)) / 2) / aspect)
        result.append(
            CameraMarker(name, viewpoint_of(view.camera), fov, aspect, view.split == "test")
        )
    return result


def overlay_points(
    scene: Scene | Clip, cameras: Path | str | None
) -> tuple[Float[np.ndarray, "points 3"], UInt8[np.ndarray, "points 3"]]:
    """Points in world space and their 8-bit sRGB colours, at most `MAX_POINTS`.

    They are the capture's points, or else the centres of the scene's Gaussians at rest.

    Args:
        scene: the scene; of a segmented one, the first segment counts.
        cameras: folder of the capture; a file, or None, has no points.
    """
    folder = Path(cameras) if cameras is not None else None
    cloud = None
    if folder is not None and folder.is_dir():
        cloud = FORMATS[format_of(folder)](folder, np.float32).points
    if cloud is not None:
        position, light = cloud.position, cloud.color
    else:
        parts = [part for one in segments_of(scene)[:1] for part in (one.static, one.moving)]
        position = np.concatenate([np.asarray(part.mean) for part in parts])
        light = np.concatenate([0.5 + C0 * np.asarray(part.harmonics)[:, 0] for part in parts])
    subset = np.random.default_rng(0).permutation(len(position))[:MAX_POINTS]
    levels = 255 * srgb_encode(np.clip(light[subset], 0, 1).astype(np.float32))
    return position[subset].astype(np.float32), np.clip(levels + 0.5, 0, 255).astype(np.uint8)
