"""The door for captures of every layout: which reader a folder is for."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import jax.numpy as jnp
from jaxtyping import DTypeLike

from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.colmap import read_colmap
from gaussray.capture.formats.colmap_files import PLACES, model_folder
from gaussray.capture.formats.dnerf import FILES, VALIDATION, read_splits
from gaussray.capture.formats.neural3d import POSES_FILE, read_neural3d, videos_of
from gaussray.capture.formats.paired import PINHOLE_FILE, Capture, View, effect_files, read_capture
from gaussray.capture.frames import BACKGROUNDS
from gaussray.capture.selection import Selection, selected


FORMATS: dict[str, Callable[[Path | str, DTypeLike], Capture]] = {
    "paired": read_capture,
    "splits": read_splits,
    "neural3d": read_neural3d,
    "colmap": read_colmap,
}
# What a folder of each format holds, for who has to make one.
NEEDS = {
    "paired": f"{PINHOLE_FILE} (or another JSON file with frames per effect)",
    "splits": f"{FILES['train']} and, to score against, {FILES['test']}",
    "neural3d": f"{POSES_FILE} and a video camNN.mp4 per camera",
    "colmap": f"cameras and images (.bin or .txt) in one of {', '.join(PLACES)}",
}


def open_capture(
    folder: Path | str,
    format: str = "auto",
    background: str = "none",
    *,
    selection: Selection | None = None,
    dtype: DTypeLike = jnp.float32,
) -> Capture:
    """What a capture folder says, by the reader of its format; pictures are not decoded.

    `format` is a name of FORMATS, or auto: what the folder holds decides (see `format_of`).
    Pictures with alpha are composited over the `background`: black or white, or none, which drops
    alpha with a warning. A `selection` takes a part of the capture. The cameras have numbers of
    `dtype`. Errors are the reader's, ValueError
    for an unknown format or background.
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
    capture = FORMATS[format_of(folder) if format == "auto" else format](folder, dtype)

    def over(views: list[View]) -> list[View]:
        return [dataclasses.replace(view, background=background) for view in views]

    effects = {name: over(views) for name, views in capture.effects.items()}
    capture = dataclasses.replace(capture, views=over(capture.views), effects=effects)
    return selected(capture, selection or Selection())


def format_of(folder: Path | str) -> str:
    """Name of the format that a folder is of.

    JSON files with frames come first (a model of COLMAP beside them is what they were made from),
    then poses_bounds.npy with videos, then COLMAP. A folder with JSON of two formats is an error,
    and one of no format is another that lists what each needs. Both are CaptureError; a folder that
    does not exist is FileNotFoundError.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder}: the capture folder does not exist.")
    paired = (folder / PINHOLE_FILE).is_file()
    split = [name for name in (*FILES.values(), VALIDATION) if (folder / name).is_file()]
    if paired and split:
        raise CaptureError(
            f"{folder}: capture.format (truth_format) must be given for a folder that holds both "
            f"{PINHOLE_FILE} and {split[0]}, got auto. Choose one of {', '.join(FORMATS)}."
        )
    if split:
        return "splits"
    if paired or effect_files(folder):
        return "paired"
    if (folder / POSES_FILE).is_file() and (videos_of(folder) or model_folder(folder) is None):
        return "neural3d"
    if model_folder(folder) is not None:
        return "colmap"
    needs = "; ".join(f"{name} needs {what}" for name, what in NEEDS.items())
    raise CaptureError(
        f"{folder}: a capture must hold the files of one format, got none of them: {needs}. "
        "Name the folder that has them."
    )
