"""What a folder holds that is no capture of a known format, and what to do about it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from gaussray.capture.formats.colmap_files import PLACES
from gaussray.capture.formats.picture_places import KNOWN_SUFFIXES
from gaussray.capture.formats.transforms import json_if_readable
from gaussray.capture.side_folders import holds_other_maps
from gaussray.capture.videos import VIDEO_SUFFIXES


_DATA = (".json", ".txt", ".npy", ".npz", ".xml", ".csv", ".yml", ".yaml", ".toml", ".bin")
_MEDIA = (*KNOWN_SUFFIXES, *VIDEO_SUFFIXES, ".heic")
# A calibration of EasyMocap and EasyVolcap.
_EASY_FILE = "intri.yml"
# Folders that are looked at for what lies deeper.
_LOOKED_AT = 50
# Other tools, and their commands that write COLMAP's model, which is read.
_EXPORTS = {
    "OpenSfM": "bin/opensfm export_colmap",
    "AliceVision (Meshroom)": "aliceVision_exportColmap",
    "OpenMVG": "openMVG_main_openMVG2Colmap",
}


def remedy_for(folder: Path, is_capture: Callable[[Path], bool]) -> str:
    """What a folder of no format holds, and what to do about it; empty if nothing is known.

    Args:
        folder: an existing folder.
        is_capture: whether a folder in it is a capture.
    """
    inner = [str(path) for path in folders_in(folder) if is_capture(path)][:3]
    if (folder / _EASY_FILE).is_file():
        holds = [place for place in folders_in(folder) if any(p.is_dir() for p in place.iterdir())]
        holds.sort(key=lambda place: place.name != "images")
        place = holds[0] if holds else folder / "images"
        return (
            f"the layout of EasyMocap and EasyVolcap ({_EASY_FILE}) is no capture yet: `gaussray "
            f"prepare videos={place} poses.calibration={folder} out=OUT` makes one. The folder "
            "must hold a folder or a video of each camera, by the camera's name."
        )
    if inner:
        return f"name {' or '.join(inner)}, which is one."
    for place in PLACES:
        for suffix in (".bin", ".txt"):
            if (folder / place / f"cameras{suffix}").is_file():
                return (
                    f"{folder / place} holds cameras{suffix} of COLMAP's model without "
                    f"images{suffix}, which has the poses. Copy it there."
                )
    media = media_folder(folder)
    prepare = f"`gaussray prepare videos={media or 'PICTURES'} out=OUT` finds poses anew"
    tool = _tool_of(folder)
    if tool:
        return (
            f"files of {tool} are not read. `{_EXPORTS[tool]}` converts them to COLMAP's model, "
            f"which is; {prepare}."
        )
    # Of files that may be meant to hold the poses, the list of formats tells.
    if media and not any(path.suffix.lower() in _DATA for path in folder.iterdir()):
        return f"it holds videos or pictures without poses: {prepare}."
    return ""


def folders_in(folder: Path) -> list[Path]:
    """The first folders in a folder, and in these."""
    outer = sorted(path for path in folder.iterdir() if path.is_dir())[:_LOOKED_AT]
    inner = [path for some in outer for path in sorted(some.iterdir()) if path.is_dir()]
    return outer + inner[:_LOOKED_AT]


def _tool_of(folder: Path) -> str:
    """The tool whose reconstruction a folder holds; empty if none."""
    if next(folder.glob("*.sfm"), None) is not None:
        return "AliceVision (Meshroom)"
    if _has(json_if_readable(folder / "sfm_data.json"), "extrinsics"):
        return "OpenMVG"
    listed = json_if_readable(folder / "reconstruction.json")
    if isinstance(listed, list) and listed and _has(listed[0], "shots"):
        return "OpenSfM"
    return ""


def _has(content: Any, key: str) -> bool:
    return isinstance(content, dict) and key in content


def media_folder(folder: Path) -> Path | None:
    """The folder of a camera's pictures or of videos; that of these folders if there are several.
    None if there is none.

    Args:
        folder: where to look, also in its folders and in theirs.
    """
    if _holds_media(folder):
        return folder
    holding = [path for path in folders_in(folder) if _holds_media(path)]
    holding = [path for path in holding if not holds_other_maps(path)] or holding
    if not holding:
        return None
    parents = {path.parent for path in holding}
    named = [path for path in holding if path.name in ("images", "videos", "input")]
    return named[0] if named else holding[0] if len(holding) == 1 else min(parents)


def _holds_media(folder: Path) -> bool:
    return any(path.suffix.lower() in _MEDIA for path in folder.iterdir() if path.is_file())
