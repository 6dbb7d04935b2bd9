"""Reads a calibration of any known kind."""

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path

from gaussray.capture.formats.metashape import is_metashape
from gaussray.capture.formats.transforms import json_content
from gaussray.prepare.calibrations.camera_dat import camera_dats, read_camera_dats
from gaussray.prepare.calibrations.camera_files import (
    files_by_stem,
    files_of_subfolders,
    is_camera_file,
    read_camera_files,
)
from gaussray.prepare.calibrations.camera_text import (
    TEXT_RECIPE,
    is_camera_text,
    text_cameras,
)
from gaussray.prepare.calibrations.camera_values import has_matrix
from gaussray.prepare.calibrations.dlt_facing import check_dlts
from gaussray.prepare.calibrations.kalibr import is_chain, read_kalibr
from gaussray.prepare.calibrations.known_camera import (
    ALL_KINDS,
    JSON_RECIPE,
    TOML_RECIPE,
    Calibration,
    KnownCamera,
)
from gaussray.prepare.calibrations.listed_values import listed_cameras
from gaussray.prepare.calibrations.matlab import refuse_matlab
from gaussray.prepare.calibrations.nerfstudio import read_metashape_cameras, read_nerfstudio
from gaussray.prepare.calibrations.opencv_json import opencv_cameras, refuse_single_camera
from gaussray.prepare.calibrations.opencv_numbers import plain_value
from gaussray.prepare.calibrations.opencv_pose import found_pose
from gaussray.prepare.calibrations.opencv_storage import (
    is_stereo_storage,
    is_storage,
    read_stereo_storage,
    stereo_storages,
)
from gaussray.prepare.calibrations.opencv_yaml import easymocap_pair, read_easymocap
from gaussray.prepare.calibrations.panoptic import is_panoptic, panoptic_cameras
from gaussray.prepare.calibrations.pose2sim import read_toml
from gaussray.prepare.calibrations.qualisys import read_qualisys
from gaussray.prepare.calibrations.stereo_npz import is_stereo_npz, read_calibration_npz
from gaussray.prepare.calibrations.stereo_pair import (
    is_stereo_calibration,
    stereo_cameras,
)
from gaussray.prepare.calibrations.tsai import is_tsai
from gaussray.prepare.calibrations.value_names import DLT_KEY
from gaussray.prepare.calibrations.yaml_file import yaml_content
from gaussray.prepare.errors import PrepareError
from gaussray.runtime.progress import say


# Bytes of one of OpenCV's XML files in which its matrices are sought, and a camera's matrix there.
_HEAD = 1 << 16
_SQUARE = re.compile(rb"<rows>\s*3\s*</rows>\s*<cols>\s*3\s*</cols>")

# Suffixes of files that a folder may hold for other reasons: not every one is a calibration.
_NAMED_ALONE = (".npz", ".dat", ".mat")


def read_calibration(path: Path | str) -> Calibration:
    """The cameras of a calibration file or folder; its name decides which kind it is.

    Raises:
        FileNotFoundError: It does not exist.
        PrepareError: It is of no known kind, or malformed.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(
            f"poses.calibration={path}: no such file or folder. Check the path."
        )
    if path.is_dir():
        return _of_folder(path)
    pair = easymocap_pair(path) if not is_stereo_storage(path) else None
    if pair is not None and not is_stereo_storage(*pair):
        return Calibration(read_easymocap(*pair))
    reader = _reader(path)
    if reader is None:
        text = f"Or as text: {TEXT_RECIPE} " if path.suffix.lower() in (".txt", ".csv") else ""
        raise PrepareError(
            f"poses.calibration={path}: must be a calibration of a kind that is read, got "
            f"{path.suffix or path.name}. {TOML_RECIPE}. {text}{ALL_KINDS}"
        )
    cameras = reader(path)
    return cameras if isinstance(cameras, Calibration) else Calibration(cameras)


def _of_folder(folder: Path) -> Calibration:
    """The cameras of the one calibration in a folder."""
    files = [p for p in sorted(folder.iterdir()) if p.is_file()]
    stereo = stereo_storages(folder)
    pair = easymocap_pair(folder) if not stereo else None
    # Pose2Sim writes its pair beside the TOML file, which also knows sizes and fisheyes.
    if pair is not None and not any(p.suffix.lower() == ".toml" for p in files):
        return Calibration(read_easymocap(*pair))
    inside = [p for p in files if not _may_be_other(p) and _reader(p) is not None]
    if single := [p for p in inside or files if is_camera_file(p)]:
        others = [p for p in inside if p not in single]
        return _of_single_cameras(folder, files_by_stem(single), others)
    # Caliscope keeps other files beside its own, and OpenCV's samples their chessboard.
    own = [p for p in inside if not is_storage(p)] + [p for p in files if is_stereo_npz(p)]
    found = sorted([*own, *stereo, *camera_dats(folder), *(pair or ())])
    if not found and (single := files_of_subfolders(folder)):
        return _of_single_cameras(folder, single, [])
    # Of files that are refused the message of a single one tells most.
    found = found or _likely(folder, inside, files)
    likely = [p for p in found if p.name == "camera_array.toml"] or found
    if len(likely) != 1:
        names = ", ".join(p.name for p in likely[:9]) or "none"
        raise PrepareError(
            f"poses.calibration={folder}: the folder must hold one calibration, got {names}. "
            f"{'Name the file' if likely else TOML_RECIPE}. {ALL_KINDS}"
        )
    return read_calibration(likely[0])


def _may_be_other(path: Path) -> bool:
    """Whether a file may lie in the folder of a calibration for other reasons, as a .txt or .csv of
    numbers does."""
    text = path.suffix.lower() in (".txt", ".csv") and not path.name.lower().startswith("krt")
    return path.suffix.lower() in _NAMED_ALONE or (text and is_camera_text(path))


def _likely(folder: Path, inside: list[Path], files: list[Path]) -> list[Path]:
    """What stands for a calibration in the message that refuses it, if a folder holds none that is
    read.

    Args:
        folder: the folder.
        inside: its files that a reader may read.
        files: all its files.
    """
    others = [p for p in files if p.suffix.lower() in (".npz", ".mat") or is_camera_text(p)]
    yaml = [p for p in inside if p.suffix.lower() != ".xml"]
    return yaml or _likely_storage(folder) or others


def _of_single_cameras(folder: Path, files: dict[str, Path], others: list[Path]) -> Calibration:
    """The cameras of a folder with files of one camera each. One file of all cameras beside them
    is read instead.

    Args:
        folder: the folder, for messages.
        files: the file of each camera by the camera's name.
        others: files beside them that may hold all cameras, or something else.
    """
    found = {p.name: one for p in others if (one := _calibration_if_readable(p)) is not None}
    where = f"poses.calibration={folder}"
    if len(found) > 1 or (len(files) == 1 and not found):
        rule = "one calibration of all cameras, or a file for each camera, called as its video"
        names = ", ".join([*found, *(str(p.relative_to(folder)) for p in files.values())][:9])
        raise PrepareError(f"{where}: the folder must hold {rule}, got {names}. Name the file.")
    unread = ", ".join(p.name for p in others[:9])
    if found:
        ((name, calibration),) = found.items()
        say(f"{where}: {name} is read, and not the files of single cameras beside it.")
        return calibration
    names = ", ".join(files)
    say(
        f"{where}: the cameras {names} are each read from their own file"
        + (f", and {unread} {'is' if len(others) == 1 else 'are'} not." if unread else ".")
    )
    return read_camera_files(where, files)


def _calibration_if_readable(path: Path) -> Calibration | None:
    """The cameras of a file that may be no calibration; None if it is none."""
    reader = _reader(path)
    try:
        cameras = reader(path) if reader is not None else []
    except (PrepareError, OSError, ValueError):
        return None
    cameras = cameras if isinstance(cameras, Calibration) else Calibration(cameras)
    return cameras if cameras.cameras else None


def _read_json(path: Path) -> list[KnownCamera] | Calibration:
    content = json_content(path)
    if is_panoptic(content):
        return panoptic_cameras(path, content)
    if isinstance(content, dict) and isinstance(content.get("frames"), list):
        return read_nerfstudio(path)
    cameras = _cameras_of(path, content)
    if cameras is None:
        raise PrepareError(
            f"poses.calibration={path}: must list frames (nerfstudio) or cameras, got "
            f"{_outline(content)}. {JSON_RECIPE}. {ALL_KINDS}"
        )
    return cameras


def _read_yaml(path: Path) -> list[KnownCamera] | Calibration:
    content = yaml_content(path)
    # The lens of one camera alone, and what has no cameras, is told of as of Kalibr's files.
    cameras = None
    if not is_chain(content) and not (has_matrix(content) and found_pose(content) is None):
        cameras = _cameras_of(path, content)
    return read_kalibr(path) if cameras is None else cameras


def _cameras_of(path: Path, content: object) -> Calibration | None:
    """The cameras of the values of a JSON or YAML file; None if it has none."""
    if isinstance(content, dict) and is_stereo_calibration(content):
        values = {str(key): plain_value(value) for key, value in content.items()}
        return stereo_cameras(path, values, name=path.name)
    listed = listed_cameras(path, content)
    return opencv_cameras(path, content) if listed is None else listed


def _read_text(path: Path) -> Calibration:
    text = text_cameras(path)
    if text.alone is not None:
        refuse_single_camera(path)
    blocks = text.cameras
    cameras = opencv_cameras(path, blocks)
    assert cameras is not None
    check_dlts(path, [one.pose for one in cameras.cameras if DLT_KEY in blocks[one.name]])
    if text.in_order:
        say(f"{path}: each column has the 11 coefficients of a camera (DLT), whose twelfth is 1.")
        return dataclasses.replace(cameras, in_order=True)
    if list(blocks) == [str(i) for i in range(len(blocks))]:
        say(f"{path}: {len(blocks)} cameras without a name are called by their number, from 0.")
    if any("K" in one for one in blocks.values()):
        say(
            f"{path}: distortion is k1 k2 p1 p2 k3 as OpenCV has them, and the unit that of t, "
            "which is the millimetre in Multiface's files."
        )
    return cameras


def _outline(content: object) -> str:
    """The keys of what a JSON file holds, and those of the first part of it that has keys."""
    if not isinstance(content, dict | list):
        return str(content)[:80]
    parts = [content, *(content.values() if isinstance(content, dict) else content)]
    keys = [", ".join(one)[:120] for one in parts if isinstance(one, dict) and one]
    return " with ".join(keys[:2]) or "nothing"


def _likely_storage(folder: Path) -> list[Path]:
    """That of OpenCV's XML files in a folder and its subfolders which is most likely of a camera;
    empty if there are none. It stands for the others in the message that refuses them."""
    found = [*sorted(folder.glob("*.xml")), *sorted(folder.glob("*/*.xml"))]
    best = max(filter(is_storage, found), key=_matrix_counts, default=None)
    return [] if best is None else [best]


def _matrix_counts(path: Path) -> tuple[int, int]:
    """Matrices in one of OpenCV's XML files: of 3 x 3 numbers, as cameras have, and of all."""
    with path.open("rb") as file:
        text = file.read(_HEAD)
    return len(_SQUARE.findall(text)), text.count(b"<rows>")


def _reader(path: Path) -> Callable[[Path], list[KnownCamera] | Calibration] | None:
    name = path.name.lower()
    if is_storage(path):
        return read_stereo_storage
    if name.endswith(".xml") and is_metashape(path):
        return read_metashape_cameras
    if is_tsai(path):
        return refuse_single_camera
    if name.endswith((".qca.txt", ".xml", ".qca")):
        return read_qualisys
    if is_camera_text(path):
        return _read_text
    suffixes = {".toml": read_toml, ".yaml": _read_yaml, ".yml": _read_yaml}
    suffixes |= {".json": _read_json, ".npz": read_calibration_npz, ".dat": read_camera_dats}
    suffixes[".mat"] = refuse_matlab
    return suffixes.get(path.suffix.lower())
