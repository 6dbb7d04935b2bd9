"""Photographs with cameras of Agisoft Metashape: the XML file of "Export Cameras".

The lenses are those of the appendix "Camera models" of Metashape's manual.
"""

import math
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import DTypeLike

from gaussray.capture.capture import Capture
from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.completion import KNOWN_SUFFIXES
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.rig import film_of, rig_capture
from gaussray.capture.formats.transforms import views_of
from gaussray.geometry import BLENDER_AXES
from gaussray.io.safe.files import parse_xml, read_text
from gaussray.io.safe.limits import within


_REMEDY = "Export it again: File > Export > Export Cameras, Agisoft XML."
# Where the pictures lie, if not beside the XML file.
_IMAGES = "images"
_COEFFICIENTS = ("cx", "cy", "k1", "k2", "k3", "k4", "p1", "p2", "b1", "b2")
# What shifts no pixel by more than this is left out without a word.
_PIXELS = 0.5


def is_metashape(path: Path) -> bool:
    """Whether an XML file begins as those of Metashape do."""
    with path.open("rb") as file:
        head = file.read(2000)
    return b"<document" in head and b"<chunk" in head


def metashape_file(folder: Path) -> Path | None:
    """The first XML file in a folder that lists cameras of Metashape; None if there is none."""
    files = (path for path in sorted(folder.glob("*.xml")) if path.is_file())
    return next(filter(is_metashape, files), None)


def read_metashape(folder: Path | str, dtype: DTypeLike = jnp.float32) -> Capture:
    """The photographs of an exported XML file, as a still scene; or the films of its cameras.

    Cameras stay where Metashape's chunk has them: its transform into a geographic world (often
    millions of metres from its origin) is not applied, so that the scale is arbitrary. Cameras
    that were not aligned are left out, and of several components all but the largest, with a
    warning. The pictures lie in `images/` and its folders or beside the file, by the cameras'
    labels. Where a label, with or without its suffix, is the name of a folder of pictures or of a
    video (`images/cam01/`, `cam01.mp4`), the cameras stand still and these are what they film, all
    pictures of one number at one time. None is held out, and points are not read.

    Args:
        folder: the folder with the XML file.
        dtype: type of the cameras' numbers.

    Raises:
        CaptureError: the file contradicts the format; the message names file and camera.
        FileNotFoundError: there is no such file.
    """
    folder = Path(folder)
    path = metashape_file(folder)
    if path is None:
        raise FileNotFoundError(f"{folder}: no XML file lists cameras of Metashape. {_REMEDY}")
    frames, top = metashape_frames(path, _pictures(folder)), Keys(path, {})
    films = {frame.text("camera"): film_of(top, frame.text("camera")) for frame in frames}
    if any(films.values()):
        return rig_capture(top, frames, films, dtype)
    views = views_of(top, frames, dtype)
    return Capture(folder, views, {}, None, (0.0, 0.0), "normalised")


def metashape_frames(path: Path, pictures: Mapping[str, str]) -> list[Keys]:
    """The cameras of an exported XML file, as the frames of a transforms.json.

    Args:
        path: the file.
        pictures: paths of pictures by the labels of cameras in lower case. A camera of another
            label is one of a picture that does not exist.

    Raises:
        CaptureError: the file contradicts the format; the message names file and camera.
    """
    chunk, top = _chunk(path), Keys(path, {})
    cameras = _aligned(top, chunk)
    within(path, "the cameras", len(cameras), "frames")
    used = {camera.get("sensor_id") for camera in cameras}
    sensors = [s for s in chunk.findall("sensors/sensor") if s.get("id") in used]
    read = {sensor.get("id", ""): _lens(top, sensor) for sensor in sensors}
    _warn_of_shifts(top, [shifts for _, shifts in read.values()])
    lenses = {number: lens for number, (lens, _) in read.items()}
    return [_frame(path, k, camera, lenses, pictures) for k, camera in enumerate(cameras)]


def _chunk(path: Path) -> ElementTree.Element:
    """The chunk of the file that has cameras."""
    text = read_text(path)
    try:
        root = parse_xml(path, text)
    except ValueError as error:
        raise CaptureError(f"{error} {_REMEDY}") from None
    chunks = [chunk for chunk in root.findall("chunk") if chunk.find("cameras") is not None]
    if len(chunks) != 1:
        raise CaptureError(
            f"{path}: must hold one chunk with cameras, got {len(chunks)}. {_REMEDY}"
        )
    return chunks[0]


def _aligned(top: Keys, chunk: ElementTree.Element) -> list[ElementTree.Element]:
    """The cameras of the largest component that have a pose."""
    listed = list(chunk.iterfind("cameras//camera"))
    posed = [camera for camera in listed if camera.find("transform") is not None]
    if not posed:
        raise CaptureError(f"{top.file}: must list cameras with a transform, got none. {_REMEDY}")
    (largest, _), *others = Counter(c.get("component_id", "") for c in posed).most_common()
    kept = [camera for camera in posed if camera.get("component_id", "") == largest]
    if len(listed) > len(posed):
        top.warn(f"{len(listed) - len(posed)} of {len(listed)} cameras have no pose: left out.")
    if others:
        top.warn(
            f"{len(posed) - len(kept)} cameras are in other components than most: left out. Align "
            "them in Metashape, or merge the components."
        )
    (label, count), *_ = Counter(camera.get("label", "") for camera in kept).most_common()
    if count > 1:
        raise CaptureError(
            f"{top.file}: each camera must have a label of its own, got {label!r} {count} times. "
            "Rename the pictures, and export the cameras again."
        )
    return kept


def _lens(top: Keys, sensor: ElementTree.Element) -> tuple[dict[str, Any], dict[str, float]]:
    """The keys of a sensor's lens, as in a transforms.json, and by how many pixels it is
    off for lack of each thing that it cannot have."""
    found = sensor.findall("calibration")
    adjusted = [node for node in found if node.get("class") == "adjusted"]
    kind = sensor.get("type", "frame")
    prefix = f"sensor {sensor.get('id')} ({sensor.get('label')}): "
    own = Keys(top.file, {"type": kind}, prefix=prefix)
    node = (adjusted or found or [sensor])[0]
    size = node.find("resolution")
    size = sensor.find("resolution") if size is None else size
    sides = {} if size is None else size.attrib
    width, height = (_number(own, key, sides.get(key)) for key in ("width", "height"))
    if kind == "spherical":
        lens = {"camera_model": "EQUIRECTANGULAR", "fl_x": width / 2, "fl_y": height}
        return {**lens, "w": width, "h": height, "cx": width / 2, "cy": height / 2}, {}
    k = {name: _number(own, name, node.findtext(name), 0.0) for name in _COEFFICIENTS}
    f = _number(own, "f", node.findtext("f"))
    if not f > 0:
        raise Keys(own.file, {"f": f}, prefix=prefix).error("f", "above 0", _REMEDY)
    lens = {
        **{"w": width, "h": height, "fl_x": f + k["b1"], "fl_y": f},
        **{"cx": width / 2 + k["cx"], "cy": height / 2 + k["cy"]},
    }
    # From the middle to the corners, in focal lengths.
    reach = math.hypot(width, height) / 2 / f
    shifts = {"skew (b2)": abs(k["b2"]) * height / 2 / f}
    if kind == "frame":
        radial, shift = _radial(k, reach)
        shifts["fourth radial coefficient (k4)"] = f * shift
        # Metashape's P1 is OpenCV's p2, and the other way round.
        return lens | {"camera_model": "OPENCV", "p1": k["p2"], "p2": k["p1"]} | radial, shifts
    if kind not in ("fisheye", "equidistant_fisheye"):
        remedy = "Undistort the pictures in Metashape, and export their cameras."
        raise own.error("type", "frame, fisheye, equidistant_fisheye or spherical", remedy)
    tangential = max(abs(k["p1"]), abs(k["p2"]))
    shifts["tangential distortion (p1, p2) of a fisheye"] = 3 * tangential * reach**2 * f
    radial = {name: k[name] for name in ("k1", "k2", "k3", "k4")}
    return lens | {"camera_model": "OPENCV_FISHEYE"} | radial, shifts


def _warn_of_shifts(top: Keys, shifts: list[dict[str, float]]) -> None:
    """One warning for each thing that Metashape's lenses have and those here have not."""
    for name in sorted({name for some in shifts for name in some}):
        sizes = [some[name] for some in shifts if some.get(name, 0.0) > _PIXELS]
        if sizes:
            top.warn(
                f"the {name} of {len(sizes)} of {len(shifts)} lenses cannot be followed exactly: "
                f"pixels are up to {max(sizes):.1f} off."
            )


def _radial(k: dict[str, float], reach: float) -> tuple[dict[str, float], float]:
    """The three radial coefficients of OpenCV that come closest to Metashape's four, and how many
    focal lengths they are off at most, of pixels at most `reach` focal lengths from the middle."""
    three = {name: k[name] for name in ("k1", "k2", "k3")}
    if not k["k4"]:
        return three, 0.0
    # Absurd numbers are no lens, which is found out when it is made.
    with np.errstate(over="ignore", invalid="ignore"):
        r = np.linspace(0, reach, 200)
        powers = np.stack([r**3, r**5, r**7], axis=1)
        wanted = powers @ list(three.values()) + k["k4"] * r**9
    if not np.isfinite([powers.sum(), wanted.sum()]).all():
        return three, 0.0
    close = np.linalg.lstsq(powers, wanted, rcond=None)[0]
    off = float(np.abs(powers @ close - wanted).max())
    return dict(zip(three, close.tolist(), strict=True)), off


def _number(own: Keys, key: str, text: str | None, default: float | None = None) -> float:
    """The finite number that a text of the file says."""
    if text is None and default is not None:
        return default
    try:
        value = float(text or "")
    except ValueError:
        value = text
    return Keys(own.file, {key: value}, prefix=own.prefix).number(key, remedy=_REMEDY)


def _pictures(folder: Path) -> dict[str, str]:
    """The pictures by the names that a label may give them, without regard to case."""
    found: dict[str, str] = {}
    for path in [*sorted((folder / _IMAGES).rglob("*")), *sorted(folder.iterdir())]:
        if path.suffix.lower() in KNOWN_SUFFIXES:
            inside = path.relative_to(folder).as_posix()
            for name in (path.name, path.stem):
                found.setdefault(name.lower(), inside)
    return found


def _frame(
    path: Path,
    index: int,
    camera: ElementTree.Element,
    lenses: Mapping[str, dict[str, Any]],
    pictures: Mapping[str, str],
) -> Keys:
    """The keys of a camera, as of a frame in a transforms.json."""
    own = Keys(path, {**camera.attrib, "transform": camera.findtext("transform")}, index)
    label, sensor = own.text("label"), camera.get("sensor_id", "")
    if sensor not in lenses:
        raise own.error("sensor_id", "that of a sensor of the file", _REMEDY)
    values = [_number(own, "transform", text) for text in own.text("transform").split()]
    if len(values) != 16:
        raise own.error("transform", "16 numbers", _REMEDY)
    pose = np.reshape(values, (4, 4)) @ np.diag([*BLENDER_AXES, 1.0])
    # A label with or without suffix; where no picture has it, the frame is one without picture.
    named = pictures.get(label.lower()) or f"{_IMAGES}/{label}"
    keys = {"file_path": named, "camera": Path(label).stem, "split": "train", "time": 0.0}
    return Keys(path, {**lenses[sensor], **keys, "transform_matrix": pose.tolist()}, index)
