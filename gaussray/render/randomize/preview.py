"""A contact sheet of the first samples of a dataset, available while the others are rendered."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from gaussray.capture.picture_file import read_stored
from gaussray.dataset.images import srgb_levels, write_image
from gaussray.dataset.sample_manifest import SAMPLE_FILE, sample_folder


# Samples on the contact sheet, pictures in a row, and the longest side of each in pixels.
PREVIEWED, _COLUMNS, _SIDE = 10, 5, 256
PREVIEW = "preview.png"


def write_preview(out: Path, count: int) -> None:
    """Write the contact sheet of a dataset, if its first samples are complete.

    Args:
        out: folder of the dataset.
        count: number of its samples.
    """
    lines = [out / sample_folder(index) / SAMPLE_FILE for index in range(min(count, PREVIEWED))]
    if all(line.exists() for line in lines):
        write_image(out / PREVIEW, preview_sheet([_first_picture(line) for line in lines]))


def preview_sheet(pictures: Sequence[UInt8[np.ndarray, "_ _ 3"]]) -> UInt8[np.ndarray, "h w 3"]:
    """Pictures side by side in rows of five, each scaled to 256 pixels or a little less, on dark
    grey."""
    small = [_scaled(picture) for picture in pictures]
    height, width = (max(x.shape[axis] for x in small) + 4 for axis in (0, 1))
    columns = min(_COLUMNS, len(small))
    rows = -(-len(small) // columns)
    sheet = np.full((rows * height, columns * width, 3), 32, np.uint8)
    for i, x in enumerate(small):
        top = i // columns * height + (height - x.shape[0]) // 2
        left = i % columns * width + (width - x.shape[1]) // 2
        sheet[top : top + x.shape[0], left : left + x.shape[1]] = x
    return sheet


def _scaled(picture: UInt8[np.ndarray, "_ _ 3"]) -> UInt8[np.ndarray, "h w 3"]:
    """A picture whose longer side is at most 256 pixels: means of blocks, or pixels repeated."""
    longest = max(picture.shape[:2])
    if longest <= _SIDE:
        times = _SIDE // longest
        return picture.repeat(times, axis=0).repeat(times, axis=1)
    block = -(-longest // _SIDE)
    height, width = (max(x // block, 1) for x in picture.shape[:2])
    cut = picture[: height * block, : width * block]
    parts = cut.reshape(height, cut.shape[0] // height, width, cut.shape[1] // width, 3)
    return np.round(parts.mean(axis=(1, 3))).astype(np.uint8)


def _first_picture(line: Path) -> UInt8[np.ndarray, "h w 3"]:
    """The 8-bit levels of a sample's first picture."""
    frame = json.loads(line.read_text(encoding="utf-8"))["frames"][0]
    path = line.parent / frame["file_path"]
    stored = read_stored(path, frame["w"], frame["h"])
    if stored.dtype == np.uint8:
        return stored
    if stored.dtype == np.uint16:
        return (stored // 257).astype(np.uint8)
    return srgb_levels(stored)
