"""Files of the capture: transforms.json, points3d.ply, and the facts that the report shows."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from gaussray.capture.formats.poses import opengl_pose
from gaussray.capture.world_origin import MAP_COORDINATE
from gaussray.io.atomic import atomic_path
from gaussray.prepare.masks import written_mask
from gaussray.prepare.placement import Placement
from gaussray.prepare.timeline import Timeline


# Shifts of a frame against its timestamp below this many seconds are none.
_NO_SHIFT = 1e-5


def capture_document(
    placement: Placement,
    timeline: Timeline,
    files: dict[str, list[Path]],
    out: Path,
    readout: float,
) -> dict[str, Any]:
    """The content of transforms.json.

    Photographs have neither time nor camera name: each is a camera of its own. A frame that was
    exposed before or after its timestamp, or row by row, has a `shutter` block; the middle row is
    then exposed at the frame's own time.

    Args:
        placement: poses and lenses of the registered pictures. Cameras that stand still have a
            frame at every timestamp, others one at each timestamp that is registered.
        timeline: timestamps, and the shift of each frame against them.
        files: for each camera the file of each timestamp, all below `out`.
        out: the capture's folder, which file paths are relative to.
        readout: seconds from the first to the last row of a rolling shutter; 0 is a global shutter.
    """
    frames: list[dict[str, Any]] = []
    model = placement.model
    for k, name in enumerate(model.pictures):
        picture = placement.pictures[name]
        instants: Sequence[int] = (
            range(len(timeline.times)) if picture.camera in placement.still else [picture.instant]
        )
        matrix = transform_matrix(model.poses[k])
        for i in instants:
            frame: dict[str, Any] = {
                "file_path": files[picture.camera][i].relative_to(out).as_posix(),
                "split": "train",
                "transform_matrix": matrix,
                **model.lenses[k],
            }
            mask = written_mask(files[picture.camera][i])
            if mask.is_file():
                frame["mask_path"] = mask.relative_to(out).as_posix()
            if not timeline.is_static:
                frame |= {"camera": picture.camera, "time": round(float(timeline.times[i]), 6)}
                frame |= _shutter(float(timeline.shifts[picture.camera][i]), readout)
            elif readout:
                frame |= _shutter(0.0, readout)
            frames.append(frame)
    top: dict[str, Any] = {"time_unit": "seconds", "fps": timeline.rate}
    if timeline.is_static:
        top = {"static": True}
    return {**top, "ply_file_path": "points3d.ply", "frames": frames}


def transform_matrix(pose: Float[np.ndarray, "3 4"]) -> list[list[float]]:
    """Camera to world [4, 4] in OpenGL axes, as nerfstudio has it, of a world to camera matrix."""
    turn = pose[:, :3].T
    return opengl_pose(turn, -turn @ pose[:, 3]).tolist()


def write_points(
    path: Path, points: Float[np.ndarray, "n 3"], levels: UInt8[np.ndarray, "n 3"]
) -> None:
    """Write a binary PLY file of coloured points; in map coordinates, positions have 64 bits.

    Args:
        path: the file to write.
        points: positions in the world.
        levels: sRGB-encoded red, green and blue of each point.
    """
    number = "<f4" if np.abs(points).max(initial=0) < MAP_COORDINATE else "<f8"
    columns = [("x", number), ("y", number), ("z", number)]
    columns += [(name, "u1") for name in ("red", "green", "blue")]
    table = np.zeros(len(points), columns)
    for i, axis in enumerate("xyz"):
        table[axis] = points[:, i]
    for i, name in enumerate(("red", "green", "blue")):
        table[name] = levels[:, i]
    kinds = {"<f4": "float", "<f8": "double", "u1": "uchar"}
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    header += [f"property {kinds[kind]} {name}" for name, kind in columns] + ["end_header", ""]
    with atomic_path(path) as partial:
        partial.write_bytes("\n".join(header).encode() + table.tobytes())


def _shutter(shift: float, readout: float) -> dict[str, Any]:
    if readout:
        return {"shutter": {"readout": readout, "row_offset": round(shift - readout / 2, 6)}}
    if abs(shift) > _NO_SHIFT:
        return {"shutter": {"row_offset": round(shift, 5)}}
    return {}
