"""Copies a generated dataset into the folders of published datasets, which their loaders read."""

import dataclasses
import itertools
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gaussray.camera.imu import ImuOptions
from gaussray.dataset.carla_rs import CARLA_FRAMES, write_carla_rs
from gaussray.dataset.coco import write_coco
from gaussray.dataset.euroc import check_euroc_lens, euroc_writer
from gaussray.dataset.imagefolder import write_image_folder
from gaussray.dataset.images import write_pixels
from gaussray.dataset.manifest import FrameRecord
from gaussray.dataset.optical_flow import write_flo, write_kitti_flow
from gaussray.dataset.sample_files import SampleFiles
from gaussray.dataset.sample_manifest import MANIFEST, read_frames
from gaussray.geometry import BLENDER_AXES
from gaussray.io.atomic import atomic_path
from gaussray.io.safe.openimageio import oiio
from gaussray.io.validate import changed_fields
from gaussray.runtime.output import listed_names


# Frames of a sequence that the loader of Fastec-RS reads.
_FASTEC_FRAMES = 34
# Most frames of a sample that a layout takes; the others take all.
_MOST_FRAMES = {"fastec_rs": _FASTEC_FRAMES, "carla_rs": CARLA_FRAMES}
# Layouts with the path of a camera for each sample.
_OF_ONE_CAMERA = ("euroc", "carla_rs", "tum")
# TUM's levels of depth per unit; 0 is none.
_TUM_STEPS = 5000
# The labels that `dataset.layout` renders for a layout. All but tum's are needed.
LAYOUT_LABELS = {
    "fastec_rs": ("global_first", "global_middle"),
    "carla_rs": ("global_first", "global_middle"),
    "bs_rsc": ("global_middle",),
    "kitti_flow": ("flow_forward",),
    "sintel": ("flow_forward",),
    "tum": ("z",),
    "euroc": (),
    "coco": ("group",),
    "imagefolder": (),
}
# Keys of `imu` that a layout uses; all others use none.
_IMU_KEYS = {
    "euroc": tuple(field.name for field in dataclasses.fields(ImuOptions)),
    "carla_rs": ("units_per_metre", "seconds_per_unit"),
}


def check_layout(layout: str, records: Sequence[FrameRecord], note: Callable[[str], Any]) -> None:
    """Check, before it is rendered, that a layout can hold a sample.

    Args:
        layout: one of `LAYOUT_LABELS`; empty for none.
        records: the frames of the sample.
        note: gets a line about frames that the layout leaves out, if there are any.

    Raises:
        ValueError: The layout cannot describe the lens, or the sample has several cameras and the
            layout takes one.
    """
    names = list(dict.fromkeys(record.camera_name for record in records))
    if layout in _OF_ONE_CAMERA and len(names) > 1:
        got = listed_names(names, most=3)
        raise ValueError(
            f"dataset.layout={layout} takes samples of one camera, got {got} in one. Choose one "
            "with camera.names, or leave dataset.frames above 0."
        )
    if layout == "euroc":
        # The files describe the lens of the first frame.
        check_euroc_lens(records[0].camera.lens.record().keys, "dataset.layout")
    most = _MOST_FRAMES.get(layout, len(records))
    if len(records) > most:
        count = len(records)
        note(f"dataset.layout={layout} takes {most} frames of a sample; {count} are rendered.")


def check_imu_keys(imu: ImuOptions, layout: str, key: str) -> None:
    """Check that a layout uses every key of the IMU that differs from its default.

    Args:
        imu: the options.
        layout: name of the layout; empty for none.
        key: the key that chooses it, for messages.

    Raises:
        ValueError: A key has no effect.
    """
    if layout not in ("", "webdataset", *LAYOUT_LABELS):
        # The layout itself is refused where it is used.
        return
    used = _IMU_KEYS.get(layout, ())
    for name in changed_fields(imu):
        if name not in used:
            layouts = " or ".join(layout for layout, keys in _IMU_KEYS.items() if name in keys)
            choice = f"with {key}={layout}" if layout else f"without {key}"
            raise ValueError(
                f"imu.{name} has no effect {choice}. Choose {key}={layouts}, or leave out "
                f"imu.{name}."
            )


def write_layout(
    data: Path | str, out: Path | str, layout: str, *, imu: ImuOptions | None = None
) -> int:
    """Copy a dataset into the layout of a published one.

    fastec_rs: OUT/SAMPLE/000_rolling.png, 000_global_first.png, 000_global_middle.png, ... (Liu et
    al. 2020), of frames with the labels global_first and global_middle.
    carla_rs: OUT/SAMPLE/0000_rs.png, 0000_gs_f.png, 0000_gs_m.png, ... and gt_vel.log (Liu et al.
    2020), of the same labels; the log has the camera's turn rate and velocity at the first row of
    the first frame (`write_carla_rs`).
    bs_rsc: OUT/SAMPLE/RS/00000.png and GS/00000.png, ... (Cao et al. 2022), of frames with the
    label global_middle.
    kitti_flow: OUT/training/image_2/000000_10.png, 000000_11.png and flow_occ/000000_10.png
    (KITTI 2015), of every two frames that follow one another, with the label flow_forward.
    sintel: OUT/training/final/SAMPLE/frame_0001.png and flow/SAMPLE/frame_0001.flo (MPI Sintel), of
    samples of at least two frames with the label flow_forward.
    tum: OUT/SAMPLE/rgb/000000.png, rgb.txt and groundtruth.txt (TUM RGB-D): the camera to world at
    the time of each frame, with axes right, down, forward. With the label z also depth/000000.png
    and depth.txt: depth along the camera's axis, 5000 levels a unit in 16 bits; 0 where no surface
    is seen or where it is farther than 13.107 units.
    euroc: OUT/SAMPLE/mav0 with cam0, imu0 and state_groundtruth_estimate0 (Burri et al. 2016,
    `euroc_writer`).
    coco: OUT/images/SAMPLE_0000.png and instances.json (Lin et al. 2014), with the label group:
    rigid bodies are instances, told apart by their number in every frame of a sample.
    imagefolder: OUT/train/images/SAMPLE_0000.png and OUT/train/metadata.jsonl (Hugging Face), with
    all labels that there are (`write_image_folder`).

    Args:
        data: folder of the dataset, whose pictures are PNG files.
        out: folder of the layout.
        layout: one of `LAYOUT_LABELS`.
        imu: the inertial measurement unit of euroc, whose units of length and time also count for
            the velocities of carla_rs; None for the default one.

    Returns:
        The number of frames, or of flows.

    Raises:
        ValueError: The layout is unknown, or the dataset lacks a label, PNG files or frames.
        OSError: A file cannot be read or written.
    """
    if layout not in LAYOUT_LABELS:
        layouts = ", ".join(LAYOUT_LABELS)
        raise ValueError(f"layout must be one of webdataset, {layouts}, got {layout!r}.")
    data, out, written = Path(data), Path(out), 0
    samples = _samples(data)
    if layout == "coco":
        return write_coco(samples, out)
    if layout == "imagefolder":
        return write_image_folder(samples, out)
    imu = imu or ImuOptions()
    writers = {
        **_LAYOUTS,
        "carla_rs": lambda source, out, _: write_carla_rs(source, out, imu),
        "euroc": euroc_writer(imu),
    }
    for source in samples:
        written += writers[layout](source, out, written)
    if not written:
        raise ValueError(
            f"{data / MANIFEST}: layout={layout} must have samples of at least two frames. Render "
            "the dataset with dataset.frames=2 or more."
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
    with atomic_path(folder / "meta.log") as partial:
        partial.write_text(f"{source.name}\n", encoding="utf-8")
    return min(len(source.frames), _FASTEC_FRAMES)


def _bs_rsc(source: SampleFiles, out: Path, _: int) -> int:
    folder = out / source.name
    for i, frame in enumerate(source.frames):
        source.copy(source.file(frame), folder / f"RS/{i:05d}.png")
        source.copy(source.file(frame, "global_middle"), folder / f"GS/{i:05d}.png")
    return len(source.frames)


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
    from scipy.spatial.transform import Rotation

    folder = out / source.name
    lists = {"rgb": ["# timestamp filename"], "groundtruth": ["# timestamp tx ty tz qx qy qz qw"]}
    for i, frame in enumerate(source.frames):
        time = f"{frame['time']:.9f}"
        source.copy(source.file(frame), folder / f"rgb/{i:06d}.png")
        lists["rgb"].append(f"{time} rgb/{i:06d}.png")
        depth = source.layer(frame, "z")
        if depth is not None:
            levels = depth_levels(depth)[..., None]
            spec = oiio.ImageSpec(levels.shape[1], levels.shape[0], 1, oiio.UINT16)
            write_pixels(folder / f"depth/{i:06d}.png", levels, spec)
            lists.setdefault("depth", ["# timestamp filename"]).append(f"{time} depth/{i:06d}.png")
        matrix = np.array(frame["transform_matrix"], np.float64)
        turn = Rotation.from_matrix(matrix[:3, :3] * np.array(BLENDER_AXES)).as_quat()
        values = " ".join(f"{x:.9f}" for x in (*matrix[:3, 3], *turn))
        lists["groundtruth"].append(f"{time} {values}")
    for name, lines in lists.items():
        with atomic_path(folder / f"{name}.txt") as partial:
            partial.write_text("\n".join([*lines, ""]), encoding="utf-8")
    return len(source.frames)


def depth_levels(depth: np.ndarray) -> np.ndarray:
    """Depth as TUM stores it, in 16 bits; 0 where there is none or it does not fit."""
    levels = np.round(_TUM_STEPS * np.nan_to_num(depth, nan=0.0, posinf=0.0))
    return np.where(levels < 1 << 16, levels, 0).astype(np.uint16)


# Writers of a sample in each layout; they get the number of what was written before.
_LAYOUTS: dict[str, Callable[[SampleFiles, Path, int], int]] = {
    "fastec_rs": _fastec_rs,
    "bs_rsc": _bs_rsc,
    "kitti_flow": _kitti_flow,
    "sintel": _sintel,
    "tum": _tum,
}
