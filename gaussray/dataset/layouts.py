"""Copies a generated dataset into the folders of published datasets, which their loaders read."""

import itertools
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from gaussray.dataset.coco import write_coco
from gaussray.dataset.optical_flow import write_flo, write_kitti_flow
from gaussray.dataset.sample_files import SampleFiles
from gaussray.dataset.takes import MANIFEST, read_frames
from gaussray.geometry import BLENDER_AXES
from gaussray.io.atomic import whole


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
    tum: OUT/SAMPLE/rgb/000000.png, rgb.txt and groundtruth.txt (TUM RGB-D): the camera to world at
    the time of each frame, with axes right, down, forward.
    coco: OUT/images/SAMPLE_0000.png and instances.json (Lin et al. 2014), with the label group:
    rigid bodies are instances, told apart by their number in every frame of a sample.

    Args:
        data: Folder of the dataset, whose pictures are PNG files.
        out: Folder of the layout.
        layout: One of `DATASET_LAYOUTS`, or coco.

    Returns:
        The number of frames, or of flows.

    Raises:
        ValueError: The layout is unknown, or the dataset lacks a label, PNG files or frames.
        OSError: A file cannot be read or written.
    """
    known = [*DATASET_LAYOUTS, "coco"]
    if layout not in known:
        raise ValueError(f"layout must be one of webdataset, {', '.join(known)}, got {layout!r}.")
    data, out, written = Path(data), Path(out), 0
    samples = _samples(data)
    if layout == "coco":
        return write_coco(samples, out)
    for source in samples:
        written += DATASET_LAYOUTS[layout](source, out, written)
    if not written:
        raise ValueError(
            f"{data / MANIFEST}: layout={layout} must have samples of at least two frames. Render "
            "the dataset with factory.frames=2 or more."
        )
    return written


def _samples(data: Path) -> Iterator[SampleFiles]:
    """The samples of a dataset, one after another."""
    for index, frames in itertools.groupby(read_frames(data), lambda f: f["take"]["index"]):
        yield SampleFiles(data, f"{index:06d}", list(frames))


def _fastec_rs(source: SampleFiles, out: Path, _: int) -> int:
    folder = out / source.name
    for i, frame in enumerate(source.frames[:_FASTEC_FRAMES]):
        source.copy(source.file(frame), folder / f"{i:03d}_rolling.png")
        for label in ("global_first", "global_middle"):
            source.copy(source.file(frame, label), folder / f"{i:03d}_{label}.png")
    # The loader looks for folders with this file and does not read it.
    with whole(folder / "meta.log") as partial:
        partial.write_text(f"{source.name}\n", encoding="utf-8")
    return min(len(source.frames), _FASTEC_FRAMES)


def _kitti_flow(source: SampleFiles, out: Path, begin: int) -> int:
    folder = out / "training"
    for number, (frame, after) in enumerate(itertools.pairwise(source.frames), begin):
        source.copy(source.file(frame), folder / f"image_2/{number:06d}_10.png")
        source.copy(source.file(after), folder / f"image_2/{number:06d}_11.png")
        write_kitti_flow(folder / f"flow_occ/{number:06d}_10.png", source.flow(frame))
    return max(len(source.frames) - 1, 0)


def _sintel(source: SampleFiles, out: Path, _: int) -> int:
    count = len(source.frames)
    if count < 2:
        return 0
    for i, frame in enumerate(source.frames, 1):
        name = f"{source.name}/frame_{i:04d}"
        source.copy(source.file(frame), out / f"training/final/{name}.png")
        if i < count:
            write_flo(out / f"training/flow/{name}.flo", source.flow(frame))
    return count - 1


def _tum(source: SampleFiles, out: Path, _: int) -> int:
    pictures = ["# timestamp filename"]
    poses = ["# timestamp tx ty tz qx qy qz qw"]
    for i, frame in enumerate(source.frames):
        source.copy(source.file(frame), out / source.name / f"rgb/{i:06d}.png")
        pictures.append(f"{frame['time']:.9f} rgb/{i:06d}.png")
        matrix = np.array(frame["transform_matrix"], np.float64)
        turn = Rotation.from_matrix(matrix[:3, :3] * np.array(BLENDER_AXES)).as_quat()
        values = " ".join(f"{x:.9f}" for x in (*matrix[:3, 3], *turn))
        poses.append(f"{frame['time']:.9f} {values}")
    for name, lines in (("rgb.txt", pictures), ("groundtruth.txt", poses)):
        with whole(out / source.name / name) as partial:
            partial.write_text("\n".join([*lines, ""]), encoding="utf-8")
    return len(source.frames)


# Writers of a sample in each layout; they get the number of what was written before.
DATASET_LAYOUTS: dict[str, Callable[[SampleFiles, Path, int], int]] = {
    "fastec_rs": _fastec_rs,
    "kitti_flow": _kitti_flow,
    "sintel": _sintel,
    "tum": _tum,
}
