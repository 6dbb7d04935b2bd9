"""What a folder holds that is no capture of a known format, and what to do about it."""

import functools
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gaussray.capture.formats.actorshq import CALIBRATION_FILE
from gaussray.capture.formats.bundler import BUNDLE_FILES
from gaussray.capture.formats.colmap_files import PLACES
from gaussray.capture.formats.euroc import euroc_near_miss
from gaussray.capture.formats.immersive import MODELS_FILE
from gaussray.capture.formats.kitti import (
    KITTI_CALIBRATION,
    is_kitti_without_poses,
    kitti_near_miss,
)
from gaussray.capture.formats.nerfies import DATASET_FILE
from gaussray.capture.formats.picture_folder import folders_in, media_folder, media_in
from gaussray.capture.formats.pinf import INFO_FILE
from gaussray.capture.formats.project_files import head_of
from gaussray.capture.formats.sevenscenes import sevenscenes_near_miss
from gaussray.capture.formats.transforms import PINHOLE_FILE, json_if_readable
from gaussray.capture.formats.tum import tum_near_miss
from gaussray.capture.side_folders import holds_other_maps
from gaussray.io.safe.files import opened
from gaussray.runtime.output import first_of


_DATA = (".json", ".txt", ".npy", ".npz", ".xml", ".csv", ".yml", ".yaml", ".toml", ".bin")
# Calibrations of EasyMocap and EasyVolcap, and of Pose2Sim's converter to them, in lower case.
_EASY_FILES = ("intri.yml", "intrinsic.yml")
# What the other calibrations hold that `gaussray prepare` reads, by the end of their names: those
# of Anipose, Caliscope and Pose2Sim, Qualisys, Kalibr, Panoptic Studio, and stereo calibrations.
_QUALISYS = (rb"<intrinsic\b", rb"<transform\b")
_KALIBR = (rb"^cam\d+:", rb"^[ \t]+camera_model:")
_STEREO = (rb"opencv", rb"^R:", rb"^T:")
_CALIBRATIONS = (
    (".toml", (rb"^[ \t]*matrix[ \t]*=", rb"^[ \t]*rotation[ \t]*=")),
    (".qca.txt", _QUALISYS),
    (".xml", _QUALISYS),
    (".xml", (rb"<opencv_storage", rb"<R\b", rb"<T\b")),
    (".yaml", _KALIBR),
    (".yml", _KALIBR),
    (".yaml", _STEREO),
    (".yml", _STEREO),
    (".json", (rb'"cameras"\s*:\s*\[', rb'"K"\s*:', rb'"R"\s*:')),
    (".npz", (rb"\bR\.npy", rb"\bT\.npy")),
    (".dat", (rb"^R:", rb"^T:")),
)
# Words in a calibration that may be a camera's name: in quotes, in a list, at the start of a line.
_NAMES = re.compile(
    r"""["']([^"'\n]+)["']"""
    r"""|^[ \t]*-[ \t]*([\w.-]+)[ \t\r]*$|^[ \t]*\[?([\w.-]+)\]?(?::|[ \t\r]*$)""",
    re.MULTILINE,
)
# Files that formats have, whatever they hold here.
_FORMAT_NAMES = {CALIBRATION_FILE, DATASET_FILE, INFO_FILE, MODELS_FILE}
# Bytes of a file that are looked at.
_HEAD = 100_000
# Bytes that a pointer of Git LFS has at most, and where else files of formats lie.
_POINTER_SIZE, _POINTER_PLACES = 1024, (*PLACES, "opensfm", "poses")
# Names of files that have poses in most formats: of several pointers such a one is told.
_POSES_LIKELY = re.compile(
    "reconstruction|transforms|poses|cameras|images.bin|sfm|_par|truth|trajectory"
)
# What `gaussray prepare` leaves in its folder beside a capture.
_FACTS_FILE, _COMMAND_FILE, _REPORT_FILE = "prepare.json", "run.json", "report.html"
# Files that are looked at for what they hold; files that a message names.
_LOOKED_AT, _NAMED = 50, 3
# Projects of other programs that are not text, and the commands that write what is read.
_BINARY = {
    "*.abc": "AliceVision (Meshroom): `aliceVision_convertSfMFormat -i {file} -o cameras.sfm`",
    "sfm_data.bin": "OpenMVG: `openMVG_main_ConvertSfM_DataFormat -i {file} -o sfm_data.json`",
}


def remedy_for(folder: Path, is_capture: Callable[[Path], bool]) -> str:
    """What a folder of no format holds, and what to do about it; empty if nothing is known.

    Each function of a known case returns its remedy, or an empty text for another folder.

    Args:
        folder: an existing folder.
        is_capture: whether a folder in it is a capture.
    """
    remedies = (
        _failed_preparation,
        _easymocap,
        functools.partial(_capture_inside, is_capture=is_capture),
        _pointer,
        _model_without_poses,
        _binary_project,
        _visual_sfm,
        _calibration_of_other_tool,
        _near_miss,
        _kitti_without_poses,
        _pictures_without_poses,
    )
    return next(filter(None, (remedy(folder) for remedy in remedies)), "")


def _failed_preparation(folder: Path) -> str:
    """Of a folder into which `gaussray prepare` has begun to write a capture."""
    run = json_if_readable(folder / _COMMAND_FILE)
    began = _has(run, "command") and str(run["command"]).startswith("gaussray prepare")
    if not began and not (folder / _FACTS_FILE).is_file():
        return ""
    report = folder / _REPORT_FILE
    where = f"{report} shows why" if report.is_file() else "its message says why"
    return (
        f"`gaussray prepare` failed and wrote no {PINHOLE_FILE} into it; {where}, and what to do. "
        "Run it again with that."
    )


def _easymocap(folder: Path) -> str:
    """Of the layout of EasyMocap and EasyVolcap."""
    file = next((p for p in sorted(folder.iterdir()) if p.name.lower() in _EASY_FILES), None)
    if file is None or not file.is_file():
        return ""
    videos = _folder_of_cameras(folder, file) or _fullest(folder)
    return (
        f"`gaussray prepare videos={videos} poses.calibration={folder} out=OUT` makes one of "
        f"the layout of EasyMocap and EasyVolcap ({file.name}). The folder must hold a folder, "
        "a video or a still picture of each camera, by the camera's name."
    )


def _fullest(folder: Path) -> Path:
    """The folder of folders that hold most pictures and videos; `images` comes first."""
    outer = [place for place in folders_in(folder) if any(p.is_dir() for p in place.iterdir())]
    return min(
        outer,
        key=lambda place: (
            place.name != "images",
            -sum(len(media_in(inner)) for inner in folders_in(place)),
        ),
        default=folder / "images",
    )


def _capture_inside(folder: Path, is_capture: Callable[[Path], bool]) -> str:
    """Of a folder in which there are captures."""
    inner = [str(path) for path in folders_in(folder) if is_capture(path)][:_NAMED]
    return f"name {' or '.join(inner)}, which is one." if inner else ""


def _pointer(folder: Path) -> str:
    """Of a file that may have poses, of which there is a pointer of Git LFS instead."""
    places = (folder / place for place in _POINTER_PLACES)
    inside = (path for place in places if place.is_dir() for path in sorted(place.iterdir()))
    data = [path for path in inside if path.suffix.lower() in (*_DATA, ".sfm") and path.is_file()]
    small = [path for path in data if path.stat().st_size <= _POINTER_SIZE]
    small.sort(key=lambda path: _POSES_LIKELY.search(path.name.lower()) is None)
    return next(filter(None, map(_pointer_error, small)), "")


def _pointer_error(path: Path) -> str:
    """What opening a pointer says; empty for another file."""
    try:
        opened(path).close()
    except OSError as error:
        return str(error) if "Git LFS" in str(error) else ""
    return ""


def _model_without_poses(folder: Path) -> str:
    """Of COLMAP's model without the file of its poses."""
    for place in PLACES:
        for suffix in (".bin", ".txt"):
            if (folder / place / f"cameras{suffix}").is_file():
                return (
                    f"{folder / place} holds cameras{suffix} of COLMAP's model without "
                    f"images{suffix}, which has the poses. Copy it there."
                )
    return ""


def _binary_project(folder: Path) -> str:
    """Of a project of another program in a file that is not text."""
    for pattern, command in _BINARY.items():
        file = next((path for path in sorted(folder.glob(pattern)) if path.is_file()), None)
        if file is not None:
            return (
                f"{file.name} is not read, but the text that it is converted to, by "
                f"{command.format(file=file.name)}. Or {_new_poses(media_folder(folder))}."
            )
    return ""


def _visual_sfm(folder: Path) -> str:
    """Of a model of VisualSFM."""
    file = next((path for path in sorted(folder.glob("*.nvm")) if path.is_file()), None)
    if file is None:
        return ""
    return (
        f"{file.name} of VisualSFM has poses that are not read, for no lens here has its "
        f"distortion. {_new_poses(media_folder(folder))}; a model of COLMAP and {BUNDLE_FILES[0]} "
        "of Bundler are read."
    )


def _calibration_of_other_tool(folder: Path) -> str:
    """Of a calibration that `gaussray prepare` reads."""
    calibration = _calibration_in(folder)
    if calibration is None:
        return ""
    videos = _folder_of_cameras(folder, calibration) or media_folder(folder)
    return (
        f"`gaussray prepare videos={videos or 'VIDEOS'} "
        f"poses.calibration={calibration} out=OUT` makes one with the calibration in it. The "
        "folder of the videos must hold a folder or a video of each camera, by the camera's name "
        "(left and right of a stereo calibration)."
    )


def _folder_of_cameras(folder: Path, calibration: Path) -> Path | None:
    """The folder that holds pictures, videos or folders of these by most of the names in a
    calibration; None if none holds those of two cameras.

    Args:
        folder: where to look, also in its folders and in theirs.
        calibration: its names are words in quotes, in a list of YAML, or at the start of a line.
    """
    text = head_of(calibration).decode("utf-8", "replace")
    names = {word.casefold() for found in _NAMES.findall(text) for word in found if word}
    places = [place for place in (folder, *folders_in(folder)) if not holds_other_maps(place)]
    counts = [len(names & {path.stem.casefold() for path in media_in(p)}) for p in places]
    most = max(counts, default=0)
    return places[counts.index(most)] if most > 1 else None


def _near_miss(folder: Path) -> str:
    """Of poses of a format that is read, without its pictures or other files where it has them."""
    misses = (sevenscenes_near_miss, kitti_near_miss, tum_near_miss, euroc_near_miss)
    text = next(filter(None, (miss(folder) for miss in misses)), "")
    more = "For matrices of your own, see docs/captures.md#poses-of-your-own."
    return f"{text} Or {_new_poses(media_folder(folder))}. {more}" if text else ""


def _kitti_without_poses(folder: Path) -> str:
    """Of pictures and projections of KITTI, whose lens is known."""
    if not is_kitti_without_poses(folder):
        return ""
    calibration = folder / KITTI_CALIBRATION
    return (
        f"{KITTI_CALIBRATION} has projections as KITTI's, but the poses are missing: poses.txt "
        "must have twelve numbers for each picture. `gaussray prepare "
        f"videos={media_folder(folder)} poses.lens={calibration} frames.rate=10 out=OUT` finds "
        "poses with the lens of the projections (frames.rate: KITTI has 10 pictures a second)."
    )


def _pictures_without_poses(folder: Path) -> str:
    """Of pictures or videos, alone or beside files of no format that is read."""
    media = media_folder(folder)
    if media is None:
        return ""
    data = [path.name for path in sorted(folder.iterdir()) if path.suffix.lower() in _DATA]
    # A file may have the name of a format's: then the list of formats says what it lacks.
    if not _FORMAT_NAMES.isdisjoint(data):
        return ""
    if not data:
        return f"it holds videos or pictures without poses: {_new_poses(media)}."
    return (
        f"{_new_poses(media)}, or takes those of a calibration (poses.calibration=FILE). What it "
        f"holds beside pictures ({first_of(data, _NAMED)}) is of no format that is read; "
        "docs/captures.md lists these. For matrices of your own, see "
        "docs/captures.md#poses-of-your-own."
    )


def _new_poses(media: Path | None) -> str:
    """The command that finds poses anew."""
    return f"`gaussray prepare videos={media or 'PICTURES'} out=OUT` finds poses anew"


def _calibration_in(folder: Path) -> Path | None:
    """The first file in a folder, in its folders and in theirs that `gaussray prepare` reads as a
    calibration; None if there is none."""
    for place in (folder, *folders_in(folder)):
        files = (path for path in sorted(place.iterdir()) if path.is_file())
        named = [(path, _kinds(path.name.lower())) for path in files]
        for path, kinds in [(p, found) for p, found in named if found][:_LOOKED_AT]:
            with path.open("rb") as file:
                head = file.read(_HEAD)
            for patterns in kinds:
                if all(re.search(pattern, head, re.MULTILINE) for pattern in patterns):
                    return path
    return None


def _kinds(name: str) -> list[tuple[bytes, ...]]:
    """What each kind of calibration with such a name holds."""
    return [patterns for end, patterns in _CALIBRATIONS if name.endswith(end)]


def _has(content: Any, key: str) -> bool:
    return isinstance(content, dict) and key in content
