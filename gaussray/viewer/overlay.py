"""What stands around the scene on the page: the capture's cameras and points."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from gaussray.capture.formats.paired import View
from gaussray.capture.open import FORMATS, format_of
from gaussray.color import srgb_encode
from gaussray.scene.harmonics import C0
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import Clip, segments_of
from gaussray.viewer.viewpoint import Stance, field_of, stance_of


# Most points that are sent to a page.
MOST = 50_000


class Mark(NamedTuple):
    """A camera of the capture: its name, where it first stood, vertical field (radians), width over
    height, and whether it was held out."""

    name: str
    stance: Stance
    field: float
    aspect: float
    held_out: bool


class Around(NamedTuple):
    """All of it: cameras, points and their colours, and how far away things are."""

    marks: list[Mark]
    place: Float[np.ndarray, "points 3"]
    color: UInt8[np.ndarray, "points 3"]
    scale: float


def marks(views: Sequence[View]) -> list[Mark]:
    """Every camera once. A lens that is no pinhole is shown as one of 65 degrees."""
    first = {view.camera_name: view for view in reversed(views)}
    found = []
    for name, view in sorted(first.items()):
        aspect = view.width / view.height
        field = 2 * math.atan(math.tan(math.radians(field_of(view.camera)) / 2) / aspect)
        found.append(Mark(name, stance_of(view.camera), field, aspect, view.split == "test"))
    return found


def points(
    scene: Scene | Clip, cameras: Path | str | None
) -> tuple[Float[np.ndarray, "points 3"], UInt8[np.ndarray, "points 3"]]:
    """Points and their colours: those of the capture that `cameras` names, or the centres of the
    scene's Gaussians where they rest."""
    folder = Path(cameras) if cameras is not None else None
    known = None
    if folder is not None and folder.is_dir():
        known = FORMATS[format_of(folder)](folder, np.float32).points
    if known is not None:
        place, light = known.position, known.color
    else:
        parts = [part for one in segments_of(scene)[:1] for part in (one.static, one.moving)]
        place = np.concatenate([np.asarray(part.mean) for part in parts])
        light = np.concatenate([0.5 + C0 * np.asarray(part.harmonics)[:, 0] for part in parts])
    some = np.random.default_rng(0).permutation(len(place))[:MOST]
    codes = 255 * srgb_encode(np.clip(light[some], 0, 1).astype(np.float32))
    return place[some].astype(np.float32), np.clip(codes + 0.5, 0, 255).astype(np.uint8)
