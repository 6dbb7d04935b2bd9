"""Opening a capture folder of any format: which reader it is for, and what is selected of it."""

import dataclasses
import warnings
from collections.abc import Callable
from pathlib import Path

import jax.numpy as jnp
from jaxtyping import DTypeLike

from gaussray.capture.camera_clocks import warn_of_other_clocks
from gaussray.capture.capture import Capture, View
from gaussray.capture.clip_start import with_clip_starts
from gaussray.capture.distant_origin import read_near_origin
from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.formats.actorshq import CALIBRATION_FILE, is_actorshq, read_actorshq
from gaussray.capture.formats.alicevision import alicevision_file, read_alicevision
from gaussray.capture.formats.bundler import BUNDLE_FILES, LIST_FILES, bundler_file, read_bundler
from gaussray.capture.formats.colmap import read_colmap
from gaussray.capture.formats.colmap_files import PLACES, model_folder
from gaussray.capture.formats.colmap_project import project_folder
from gaussray.capture.formats.dnerf import SPLIT_FILES, VALIDATION_FILE, read_splits
from gaussray.capture.formats.dynamic3dgs import META_FILES, read_dynamic3dgs
from gaussray.capture.formats.euroc import SENSOR_FILE, euroc_file, read_euroc
from gaussray.capture.formats.immersive import MODELS_FILE, is_immersive, read_immersive
from gaussray.capture.formats.kitti import (
    KITTI_CALIBRATION,
    has_kitti_folders,
    kitti_file,
    read_kitti,
)
from gaussray.capture.formats.llff import llff_pictures, read_llff
from gaussray.capture.formats.metashape import metashape_file, read_metashape
from gaussray.capture.formats.middlebury import PAR_FILE, middlebury_file, read_middlebury
from gaussray.capture.formats.nerfies import DATASET_FILE, is_nerfies, read_nerfies
from gaussray.capture.formats.neural3d import read_neural3d, videos_of
from gaussray.capture.formats.neus import CAMERA_FILES, neus_file, read_neus
from gaussray.capture.formats.no_capture import remedy_for
from gaussray.capture.formats.number_files import MATRIX_FILE
from gaussray.capture.formats.openmvg import SFM_DATA_FILES, openmvg_file, read_openmvg
from gaussray.capture.formats.opensfm import RECONSTRUCTION_FILES, opensfm_file, read_opensfm
from gaussray.capture.formats.paired import effect_files, read_capture
from gaussray.capture.formats.picture_folder import media_folder
from gaussray.capture.formats.pinf import INFO_FILE, is_pinf, read_pinf
from gaussray.capture.formats.poses_bounds import POSES_FILE, read_poses_bounds
from gaussray.capture.formats.record3d import METADATA_FILES, read_record3d, record3d_file
from gaussray.capture.formats.sevenscenes import (
    POSE_FILES,
    read_sevenscenes,
    sevenscenes_file,
)
from gaussray.capture.formats.technicolor import PARAMETERS_FILE, read_technicolor
from gaussray.capture.formats.transforms import PINHOLE_FILE
from gaussray.capture.formats.tum import TRAJECTORY_FILES, read_tum, tum_file
from gaussray.capture.mask_folder import with_mask_folder
from gaussray.capture.picture_file import BACKGROUNDS, picture_exists
from gaussray.capture.selection import Selection, selected
from gaussray.capture.stored_sizes import at_stored_sizes
from gaussray.capture.time_origin import with_times_from_first
from gaussray.capture.trained_tests import warn_of_trained_tests


FORMATS: dict[str, Callable[[Path | str, DTypeLike], Capture]] = {
    "paired": read_capture,
    "splits": read_splits,
    "neural3d": read_neural3d,
    "llff": read_llff,
    "dynamic3dgs": read_dynamic3dgs,
    "nerfies": read_nerfies,
    "pinf": read_pinf,
    "immersive": read_immersive,
    "technicolor": read_technicolor,
    "actorshq": read_actorshq,
    "colmap": read_colmap,
    "metashape": read_metashape,
    "neus": read_neus,
    "alicevision": read_alicevision,
    "opensfm": read_opensfm,
    "openmvg": read_openmvg,
    "bundler": read_bundler,
    "middlebury": read_middlebury,
    "record3d": read_record3d,
    "sevenscenes": read_sevenscenes,
    "kitti": read_kitti,
    "tum": read_tum,
    "euroc": read_euroc,
}
# The files of each format, for the message about a folder of none.
FORMAT_FILES = {
    "paired": f"{PINHOLE_FILE} (or another JSON file with frames per effect)",
    "splits": f"{SPLIT_FILES['train']} and, to score against, {SPLIT_FILES['test']}",
    "neural3d": f"{POSES_FILE} and a video camNN.mp4 per camera",
    "llff": f"{POSES_FILE} and pictures in images/",
    "dynamic3dgs": f"{META_FILES['train']} and pictures in ims/",
    "nerfies": f"{DATASET_FILE}, a file in camera/ for each picture, and pictures in rgb/",
    "pinf": f"{INFO_FILE} with train_videos, and the videos",
    "immersive": f"{MODELS_FILE} and a video camera_NNNN.mp4 per camera",
    "technicolor": f"{PARAMETERS_FILE} and pictures *_FRAME_CAMERA.png",
    "actorshq": f"{CALIBRATION_FILE} and pictures in rgbs/",
    "colmap": f"cameras and images (.bin or .txt) in one of {', '.join(PLACES)}",
    "metashape": "an XML file of Metashape's Export Cameras, and pictures in images/ or beside it",
    "neus": f"{' or '.join(CAMERA_FILES)} and pictures in image/",
    "alicevision": "a file *.sfm of AliceVision or Meshroom, and pictures",
    "opensfm": f"{' or '.join(RECONSTRUCTION_FILES)}, and pictures in images/",
    "openmvg": f"{SFM_DATA_FILES[0]} of OpenMVG, and pictures",
    "bundler": f"{BUNDLE_FILES[0]} of Bundler, {LIST_FILES[0]} and pictures",
    "middlebury": f"{PAR_FILE} with K, R and t of each picture, and pictures",
    "record3d": f"{METADATA_FILES[0]} of Record3D, and pictures in rgb/",
    "sevenscenes": f"{POSE_FILES}, frame-*.color.png or .jpg, and camera-intrinsics.txt",
    "kitti": f"poses.txt of twelve numbers a line, {KITTI_CALIBRATION}, and pictures in image_2/, "
    "image_0/, image_l/ or images/",
    "tum": f"{TRAJECTORY_FILES[0]} (or another trajectory of eight numbers a line), pictures in "
    "rgb/ with timestamps, and camera-intrinsics.txt",
    "euroc": f"mav0/cam0/data/ and {SENSOR_FILE} beside it, and the table of the body",
}

# Formats of which masks may lie in a folder of their own.
_MASKED = (
    "paired",
    "splits",
    "colmap",
    "llff",
    "metashape",
    "alicevision",
    "opensfm",
    "openmvg",
    "bundler",
    "middlebury",
    "record3d",
    "sevenscenes",
    "kitti",
    "tum",
    "euroc",
)


def open_capture(
    folder: Path | str,
    format: str = "auto",
    background: str = "auto",
    *,
    selection: Selection | None = None,
    dtype: DTypeLike = jnp.float32,
) -> Capture:
    """Read a capture folder; its pictures are not decoded.

    Args:
        folder: the capture.
        format: a name of FORMATS, or `auto`: the files of the folder decide (`format_of`).
        background: how alpha is treated. `black` and `white` composite it over that colour, `auto`
            over black with a warning, `mask` ignores pixels below half alpha, `none` drops alpha.
        selection: the part of the capture that is used; None is all of it.
        dtype: type of the cameras' numbers.

    Returns:
        The capture. Frames whose picture does not exist are left out (`Selection.missing`).

    Raises:
        CaptureError: format or background are unknown, or a file contradicts its format.
        FileNotFoundError: the folder does not exist.
    """
    if format not in ("auto", *FORMATS):
        raise ValueError(
            f"capture.format (truth_format) must be one of auto, {', '.join(FORMATS)}, "
            f"got {format!r}."
        )
    if background not in BACKGROUNDS:
        raise ValueError(
            f"capture.background (truth_background) must be one of {', '.join(BACKGROUNDS)}, "
            f"got {background!r}."
        )
    layout = format_of(folder) if format == "auto" else format
    capture = read_near_origin(lambda: FORMATS[layout](folder, dtype))
    if format == "auto" and layout == "colmap" and _is_of_others(capture):
        layout = "llff"
        capture = read_near_origin(lambda: read_llff(folder, dtype))
    capture = with_times_from_first(capture)
    if layout in _MASKED:
        capture = with_mask_folder(capture)

    def with_background(views: list[View]) -> list[View]:
        return [dataclasses.replace(view, background=background) for view in views]

    capture = capture.with_views(with_background)
    selection = selection or Selection()
    capture = selected(at_stored_sizes(capture), selection)
    capture = with_clip_starts(capture, selection.clip_start)
    warn_of_other_clocks(capture)
    warn_of_trained_tests(capture)
    return capture


def _is_of_others(capture: Capture) -> bool:
    """Whether a model of COLMAP names pictures that do not exist while poses_bounds.npy has a row
    for each one that does: they were renamed since. A warning says so."""
    path = capture.folder / POSES_FILE
    absent = [view.image.name for view in capture.views if not picture_exists(view.image)]
    if not absent or not path.is_file():
        return False
    count = len(llff_pictures(capture.folder))
    if len(read_poses_bounds(path)) != count:
        return False
    warnings.warn(
        f"{capture.folder}: {len(absent)} pictures of COLMAP's model do not exist, such as "
        f"{absent[0]}, but {POSES_FILE} has a row for each of the {count} that do, and is read "
        "instead. capture=colmap (truth_format=colmap) reads the model.",
        CaptureWarning,
        stacklevel=3,
    )
    return True


def format_of(folder: Path | str) -> str:
    """Name of the format of a capture folder, by its files.

    JSON files come first (a model of COLMAP beside them is what they were made from; those of
    splits before one of all frames, with a warning), then poses_bounds.npy with videos, then
    COLMAP, then poses_bounds.npy with pictures, then the XML file of Metashape, then projections of
    IDR and NeuS, then projects of AliceVision, OpenSfM, OpenMVG and Bundler, then Middlebury's
    cameras and Record3D's, then poses of 7-Scenes, KITTI, TUM and EuRoC.

    Raises:
        CaptureError: the folder holds files of no format.
        FileNotFoundError: the folder does not exist.
    """
    folder = Path(folder)
    if folder.is_file():
        raise NotADirectoryError(f"{folder}: a capture must be a folder, got a file.")
    if not folder.is_dir():
        raise FileNotFoundError(
            f"{folder}: no such folder. Name a capture's folder (capture.path, truth or cameras)."
        )
    found = _format(folder)
    if found == "splits" and (folder / PINHOLE_FILE).is_file():
        warnings.warn(
            f"{folder}: holds {PINHOLE_FILE} and {SPLIT_FILES['train']}, of which the latter is "
            "read, with those of other splits. capture=paired (truth_format=paired) reads the "
            "former.",
            CaptureWarning,
            stacklevel=3,
        )
    if found is not None:
        return found
    if remedy := remedy_for(folder, lambda inner: _format(inner) is not None):
        raise CaptureError(f"{folder}: is no capture of a known format: {remedy}")
    needs = "; ".join(f"{name} needs {what}" for name, what in FORMAT_FILES.items())
    raise CaptureError(
        f"{folder}: a capture must hold the files of one format, got none of them: {needs}. "
        f"Name the folder that has them; `gaussray prepare videos={media_folder(folder) or 'DIR'} "
        "out=OUT` makes a capture of videos or photographs, with calibrations of other tools "
        "(poses.calibration), too. For matrices of your own: docs/captures.md#poses-of-your-own."
    )


def _format(folder: Path) -> str | None:
    """Name of the format of an existing folder; None if it has the files of none."""
    paired = (folder / PINHOLE_FILE).is_file()
    split = [n for n in (*SPLIT_FILES.values(), VALIDATION_FILE) if (folder / n).is_file()]
    if split:
        return "splits"
    if not paired and (folder / META_FILES["train"]).is_file():
        return "dynamic3dgs"
    if not paired and is_nerfies(folder):
        return "nerfies"
    if not paired and is_pinf(folder):
        return "pinf"
    if paired or effect_files(folder):
        return "paired"
    if is_immersive(folder):
        return "immersive"
    if (folder / PARAMETERS_FILE).is_file():
        return "technicolor"
    if is_actorshq(folder):
        return "actorshq"
    model = model_folder(project_folder(folder))
    if (folder / POSES_FILE).is_file() and (videos_of(folder) or model is None):
        return "llff" if not videos_of(folder) and llff_pictures(folder) else "neural3d"
    if model is not None:
        return "colmap"
    if metashape_file(folder) is not None:
        return "metashape"
    found = {
        "neus": neus_file,
        "alicevision": alicevision_file,
        "opensfm": opensfm_file,
        "openmvg": openmvg_file,
        "bundler": bundler_file,
        "middlebury": middlebury_file,
        "record3d": record3d_file,
        "sevenscenes": sevenscenes_file,
        "kitti": _kitti_file,
        "tum": tum_file,
        "euroc": euroc_file,
    }
    return next((name for name, file_of in found.items() if file_of(folder) is not None), None)


def _kitti_file(folder: Path) -> Path | None:
    """The file of KITTI's poses; None where TUM's files are, with a lens that is read before the
    calibration, unless the pictures are in KITTI's folders."""
    own_lens = (folder / MATRIX_FILE).is_file() and not has_kitti_folders(folder)
    return None if own_lens and tum_file(folder) is not None else kitti_file(folder)
