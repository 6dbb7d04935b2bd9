"""Captures of LLFF (Mildenhall et al. 2019): `poses_bounds.npy` beside a folder of pictures."""

import dataclasses
import re
from pathlib import Path

import jax.numpy as jnp
from jaxtyping import DTypeLike

from gaussray.capture.capture import Capture
from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.poses_bounds import POSES_FILE, camera_keys, read_poses_bounds
from gaussray.capture.formats.transforms import points_of, views_of
from gaussray.capture.picture_file import picture_size


_PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg")
# Every eighth picture is held out, as in LLFF, NeRF and their successors.
HELD_OUT_STEP = 8


def read_llff(folder: Path | str, dtype: DTypeLike = jnp.float32) -> Capture:
    """A static capture: one picture for each row of `poses_bounds.npy`, in the order of the names.

    The pictures lie in `images/`, else in the least reduced of `images_2/`, `images_4/` ...; every
    eighth one, from the first, is held out. Each picture is a camera, named after its file.
    Starting points come from points3d.ply or sparse_pc.ply in the folder.

    Args:
        folder: the folder with `poses_bounds.npy`.
        dtype: type of the cameras' numbers.

    Raises:
        CaptureError: rows and pictures do not agree; the message says how.
        FileNotFoundError: poses_bounds.npy does not exist.
    """
    folder = Path(folder)
    rows, paths = read_poses_bounds(folder / POSES_FILE), llff_pictures(folder)
    if len(rows) != len(paths):
        where = paths[0].parent.name if paths else "images"
        raise CaptureError(
            f"{folder / POSES_FILE}: the rows must be as many as the pictures of {where}/, got "
            f"{len(rows)} and {len(paths)}. Copy the missing pictures, or remove those that have "
            "no pose."
        )
    top = Keys(folder / POSES_FILE, {})
    keys = []
    for k, (row, path) in enumerate(zip(rows, paths, strict=True)):
        frame = camera_keys(top, k, row, path, picture_size(path))
        split = "train" if k % HELD_OUT_STEP else "test"
        inside = path.relative_to(folder).as_posix()
        values = {**frame.values, "split": split, "file_path": inside}
        keys.append(dataclasses.replace(frame, values=values))
    top.warn(
        f"a capture of pictures at one time; each {HELD_OUT_STEP}th of {len(keys)} is held out."
    )
    views = views_of(top, keys, dtype)
    return Capture(folder, views, {}, points_of(top), (0.0, 0.0), "normalised")


def llff_pictures(folder: Path) -> list[Path]:
    """The pictures of an LLFF capture in the order of their names; none if there is no folder."""
    reduced = [path for path in folder.glob("images_*") if re.fullmatch(r"images_\d+", path.name)]
    reduced.sort(key=lambda path: int(path.name.removeprefix("images_")))
    for place in (folder / "images", *reduced):
        if place.is_dir():
            names = sorted(p for p in place.iterdir() if p.suffix.lower() in _PICTURE_SUFFIXES)
            if names:
                listed = {"picture": [path.relative_to(folder).as_posix() for path in names]}
                return [
                    Keys(folder / POSES_FILE, {"picture": name}).inside("picture")
                    for name in listed["picture"]
                ]
    return []
