"""Reads a calibration of any known kind and gives its cameras to those of the input."""

import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from gaussray.prepare.calibrations.kalibr import read_kalibr
from gaussray.prepare.calibrations.known_camera import KnownCamera
from gaussray.prepare.calibrations.nerfstudio import read_nerfstudio
from gaussray.prepare.calibrations.opencv_yaml import easymocap_pair, read_easymocap
from gaussray.prepare.calibrations.pose2sim import read_toml
from gaussray.prepare.calibrations.qualisys import read_qualisys
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.sources import Source


CALIBRATION_KINDS = (
    "Qualisys .qca.txt or .xml, Pose2Sim or Anipose .toml, intri.yml beside extri.yml "
    "(EasyMocap) or Intrinsic.yml beside Extrinsic.yml (Pose2Sim), Kalibr .yaml, or nerfstudio's "
    "transforms.json"
)
# A picture may be so much larger or smaller than its calibration without being another one: rows
# and columns that an encoder adds or drops.
_MARGIN = 16


def read_calibration(path: Path | str) -> list[KnownCamera]:
    """The cameras of a calibration file or folder; its name decides which kind it is.

    Raises:
        FileNotFoundError: It does not exist.
        PrepareError: It is of no known kind, or malformed.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"poses.calibration={path}: no such file or folder.")
    pair = easymocap_pair(path)
    if path.is_dir():
        inside = [p for p in sorted(path.iterdir()) if p.is_file() and _reader(p) is not None]
        # Pose2Sim writes its pair beside the TOML file, which also knows sizes and fisheyes.
        if pair is not None and not any(p.suffix.lower() == ".toml" for p in inside):
            return read_easymocap(*pair)
        if len(inside) != 1:
            names = ", ".join(p.name for p in inside[:9]) or "none"
            raise PrepareError(
                f"poses.calibration={path}: the folder must hold one calibration, got {names}. "
                f"Name the file: {CALIBRATION_KINDS}."
            )
        path = inside[0]
    elif pair is not None:
        return read_easymocap(*pair)
    reader = _reader(path)
    if reader is None:
        raise PrepareError(f"poses.calibration={path}: must be {CALIBRATION_KINDS}.")
    return reader(path)


def _reader(path: Path) -> Callable[[Path], list[KnownCamera]] | None:
    name = path.name.lower()
    if name.endswith((".qca.txt", ".xml", ".qca")):
        return read_qualisys
    suffixes = {".toml": read_toml, ".yaml": read_kalibr, ".yml": read_kalibr}
    suffixes[".json"] = read_nerfstudio
    return suffixes.get(path.suffix.lower())


def assign_cameras(
    known: Sequence[KnownCamera], sources: Sequence[Source]
) -> tuple[dict[str, KnownCamera], list[str]]:
    """The calibrated camera of each source, its lens for the source's size of pictures.

    A camera belongs to a source if it is the only one of the same name; else of the same letters
    and digits, whatever their case; else of the same last number (`cam01`, `1`).

    Args:
        known: cameras of the calibration. One of pictures of another size is used as it is if the
            sizes differ by at most 16 rows and columns, which an encoder adds or drops, and scaled
            if the pictures have the same shape.
        sources: cameras of the input; each needs a calibrated one.

    Returns:
        Camera by source name, and a remark for every camera whose size differs.

    Raises:
        PrepareError: A source has no camera of its name, or one for pictures of another shape.
    """
    result, remarks = {}, []
    for source in sources:
        camera = _named(known, source.name)
        if camera is None:
            raise PrepareError(
                f"poses.calibration must name every camera, got no {source.name} among "
                f"{', '.join(one.name for one in known)}. Rename the video or folder."
            )
        lens, remark = _resized(source, camera)
        remarks += [remark] if remark else []
        result[source.name] = KnownCamera(source.name, lens, camera.pose)
    return result, remarks


def _named(known: Sequence[KnownCamera], name: str) -> KnownCamera | None:
    for rule in (str, lambda text: re.sub(r"[^a-z0-9]", "", text.lower()), _number):
        alike = [camera for camera in known if rule(camera.name) == rule(name) != ""]
        if len(alike) == 1:
            return alike[0]
    return None


def _number(name: str) -> str:
    """The last number in a name, without leading zeros."""
    digits = re.findall(r"\d+", name)
    return str(int(digits[-1])) if digits else ""


def _resized(source: Source, camera: KnownCamera) -> tuple[dict, str]:
    lens = dict(camera.lens)
    width, height = lens["w"] or source.width, lens["h"] or source.height
    lens |= {"w": source.width, "h": source.height}
    if (width, height) == (source.width, source.height):
        return lens, ""
    sizes = f"{width} x {height} for pictures of {source.width} x {source.height}"
    if max(abs(width - source.width), abs(height - source.height)) <= _MARGIN:
        return lens, f"{source.name}: the calibration is of {sizes}; it is used as it is."
    scale = np.array([source.width / width, source.height / height])
    if abs(scale[0] / scale[1] - 1) > 5e-3:
        raise PrepareError(
            f"{source.name}: the calibration must be of pictures of the same shape, got {sizes}. "
            "Calibrate at the size of the videos, or scale the videos back."
        )
    for key, factor in zip(("fl_x", "fl_y", "cx", "cy"), (*scale, *scale), strict=True):
        lens[key] *= float(factor)
    return lens, f"{source.name}: the calibration is of {sizes}; it is scaled."
