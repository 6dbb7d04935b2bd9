"""Copies a generated dataset into the folders of published datasets, which their loaders read."""

import itertools
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from gaussray.dataset.layers import read_layers
from gaussray.dataset.optical_flow import write_flo, write_kitti_flow
from gaussray.dataset.takes import MANIFEST, read_frames
from gaussray.io.atomic import whole
from gaussray.io.safe.files import inside


_Frame = dict[str, Any]
# Frames of a sequence that the loader of Fastec-RS reads.
_FASTEC_FRAMES = 34


def write_layout(data: Path | str, out: Path | str, layout: str) -> int:
    """Copy a dataset into the layout of a published one.

    fastec_rs: OUT/SAMPLE/000_rolling.png, 000_global_first.png, 000_global_middle.png, ... (Liu et
    al. 2020), of frames with the labels global_first and global_middle.
    kitti_flow: OUT/training/image_2/000000_10.png, 000000_11.png and flow_occ/000000_10.png
    (KITTI 2015), of every two frames that follow one another, with the label flow_forward.
    sintel: OUT/training/final/SAMPLE/frame_0001.png and flow/SAMPLE/frame_0001.flo (MPI Sintel), of
    samples of at least two frames with the label flow_forward.

    Args:
        data: Folder of the dataset, whose pictures are PNG files.
        out: Folder of the layout.
        layout: One of `DATASET_LAYOUTS`.

    Returns:
        The number of frames (fastec_rs) or of flows.

    Raises:
        ValueError: The layout is unknown, or the dataset lacks a label, PNG files or frames.
        OSError: A file cannot be read or written.
    """
    if layout not in DATASET_LAYOUTS:
        raise ValueError(
            f"layout must be one of webdataset, {', '.join(DATASET_LAYOUTS)}, got {layout!r}."
        )
    data, out, written = Path(data), Path(out), 0
    for index, frames in itertools.groupby(read_frames(data), lambda f: f["take"]["index"]):
        written += DATASET_LAYOUTS[layout](
            _Source(data, f"{index:06d}", list(frames)), out, written
        )
    if not written:
        raise ValueError(
            f"{data / MANIFEST}: layout={layout} must have samples of at least two frames. Render "
            "the dataset with factory.frames=2 or more."
        )
    return written


class _Source:
    """The frames of one sample, in the order of time."""

    def __init__(self, data: Path, name: str, frames: list[_Frame]):
        self.data, self.name, self.frames = data, name, frames

    def file(self, frame: _Frame, label: str | None = None) -> Path:
        """The picture of a frame, or the file of a label."""
        name = frame["file_path"] if label is None else frame.get("labels", {}).get(label)
        if name is None:
            asked = "flow_forward" if label == "layers" else label
            raise self.lacks(f"the label {asked}", f"labels=[{asked}]")
        return inside(self.data, name, self.data / MANIFEST)

    def copy(self, source: Path, target: Path) -> None:
        """Copy a PNG file."""
        if source.suffix != ".png":
            raise self.lacks("PNG pictures", "format=png")
        with whole(target) as partial:
            shutil.copyfile(source, partial)

    def flow(self, frame: _Frame) -> np.ndarray:
        """The flow to the next frame, [h, w, 2]."""
        layers = read_layers(self.file(frame, "layers"))
        if "flow_forward.x" not in layers:
            raise self.lacks("the label flow_forward", "labels=[flow_forward]")
        return np.stack([layers["flow_forward.x"], layers["flow_forward.y"]], axis=-1)

    def lacks(self, what: str, remedy: str) -> ValueError:
        """The error that the layout needs what the dataset lacks."""
        return ValueError(
            f"{self.data / MANIFEST}: the layout needs {what}, sample {self.name} has none. Render "
            f"the dataset with {remedy}."
        )


def _fastec_rs(source: _Source, out: Path, _: int) -> int:
    folder = out / source.name
    for i, frame in enumerate(source.frames[:_FASTEC_FRAMES]):
        source.copy(source.file(frame), folder / f"{i:03d}_rolling.png")
        for label in ("global_first", "global_middle"):
            source.copy(source.file(frame, label), folder / f"{i:03d}_{label}.png")
    # The loader looks for folders with this file and does not read it.
    with whole(folder / "meta.log") as partial:
        partial.write_text(f"{source.name}\n", encoding="utf-8")
    return min(len(source.frames), _FASTEC_FRAMES)


def _kitti_flow(source: _Source, out: Path, begin: int) -> int:
    folder = out / "training"
    for number, (frame, after) in enumerate(itertools.pairwise(source.frames), begin):
        source.copy(source.file(frame), folder / f"image_2/{number:06d}_10.png")
        source.copy(source.file(after), folder / f"image_2/{number:06d}_11.png")
        write_kitti_flow(folder / f"flow_occ/{number:06d}_10.png", source.flow(frame))
    return max(len(source.frames) - 1, 0)


def _sintel(source: _Source, out: Path, _: int) -> int:
    count = len(source.frames)
    if count < 2:
        return 0
    for i, frame in enumerate(source.frames, 1):
        name = f"{source.name}/frame_{i:04d}"
        source.copy(source.file(frame), out / f"training/final/{name}.png")
        if i < count:
            write_flo(out / f"training/flow/{name}.flo", source.flow(frame))
    return count - 1


# Writers of a sample in each layout; they get the number of what was written before.
DATASET_LAYOUTS: dict[str, Callable[[_Source, Path, int], int]] = {
    "fastec_rs": _fastec_rs,
    "kitti_flow": _kitti_flow,
    "sintel": _sintel,
}
