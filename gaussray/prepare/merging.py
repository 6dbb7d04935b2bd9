"""Cameras that stand still: the features of several timestamps become those of one picture."""

from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Int
from scipy.spatial import KDTree

from gaussray.prepare.colmap import pycolmap
from gaussray.prepare.features import Keypoints, MatchingPicture


# A feature closer than this many pixels to one of an earlier timestamp is the same, seen again.
_SAME = 1.0
# A match stays where it is within so many pixels, for each 1000 pixels of width.
_STAYS = 2.0
# Cells along each side of a picture of which is asked whether they stay.
_CELLS = 8


def staying_share(
    first: Keypoints,
    last: Keypoints,
    matches: Int[np.ndarray, "m 2"],
    size: tuple[int, int],
) -> float:
    """The share of a camera's picture that is at one timestamp where it was at another: of the
    features that both share, or of 8 x 8 cells, those of whose features half or more stay,
    whichever is more. A body that moves may hold most of the features, but not most of the picture.

    Args:
        first: keypoints at the first timestamp.
        last: keypoints at the last one.
        matches: indices into `first` and `last`, at least one.
        size: columns and rows; 2 pixels per 1000 columns (at least 1) count as no movement.
    """
    before, after = first.xy[matches[:, 0]], last.xy[matches[:, 1]]
    stays = np.linalg.norm(before - after, axis=1) <= _STAYS * max(size[0] / 1000, 0.5)
    column, row = np.clip(before * _CELLS // np.array(size), 0, _CELLS - 1).astype(int).T
    cell = row * _CELLS + column
    total = np.bincount(cell, minlength=_CELLS**2)
    staying = np.bincount(cell, stays, minlength=_CELLS**2)[total > 0] / total[total > 0]
    return float(max(np.mean(stays), np.mean(staying >= 0.5)))


def merge_keypoints(parts: Sequence[Keypoints]) -> tuple[Keypoints, list[Int[np.ndarray, " n"]]]:
    """The keypoints of several timestamps in one list, and the new index of each old one.

    A keypoint at the place of an earlier one is that one: what stands still is listed once.
    """
    xy, instant, indices = parts[0].xy, parts[0].instant, [np.arange(len(parts[0].xy))]
    for part in parts[1:]:
        index = np.zeros(len(part.xy), int)
        if len(part.xy):
            far, near = np.full(len(part.xy), np.inf), np.zeros(len(part.xy), int)
            if len(xy):
                far, near = map(np.asarray, KDTree(xy).query(part.xy))
            new = far > _SAME
            index[~new] = near[~new]
            index[new] = len(xy) + np.arange(new.sum())
            xy = np.concatenate([xy, part.xy[new]])
            instant = np.concatenate([instant, part.instant[new]])
        indices.append(index)
    return Keypoints(xy, instant), indices


def merge_matches(
    parts: Sequence[Int[np.ndarray, "_ 2"]],
) -> Int[np.ndarray, "merged 2"]:
    """Matches of several timestamps in one list, in which no keypoint has two partners."""
    rows = np.concatenate(parts) if parts else np.zeros((0, 2), int)
    for column in (0, 1):
        _, keep = np.unique(rows[:, column], return_index=True)
        rows = rows[np.sort(keep)]
    return rows


def merged_database(
    source: Path,
    target: Path,
    pictures: Sequence[MatchingPicture],
    keypoints: dict[str, Keypoints],
    matches: dict[tuple[str, str], Int[np.ndarray, "m 2"]],
    still: Collection[str],
) -> dict[str, Keypoints]:
    """Write a database with one picture for each camera that stands still, named after the file of
    its first timestamp, and the pictures of the others as they are.

    Args:
        source: database with a picture for each camera and timestamp.
        target: database to write; its matches still have to be verified.
        pictures: the pictures of `source`.
        keypoints: their keypoints, by file.
        matches: matches between files.
        still: names of the cameras that stand still.

    Returns:
        The merged keypoints of each picture of `target`.
    """
    colmap = pycolmap()
    files: dict[str, list[str]] = {}
    for picture in pictures:
        owner = picture.camera if picture.camera in still else picture.file
        files.setdefault(owner, []).append(picture.file)
    new_index: dict[str, tuple[str, np.ndarray]] = {}
    merged: dict[str, Keypoints] = {}
    for names in files.values():
        merged[names[0]], indices = merge_keypoints([keypoints[name] for name in names])
        new_index |= {n: (names[0], i) for n, i in zip(names, indices, strict=True)}
    joined: dict[tuple[str, str], list[np.ndarray]] = {}
    for (a, b), rows in matches.items():
        (first, i), (second, j) = new_index[a], new_index[b]
        if first == second:
            continue
        rows = np.stack([i[rows[:, 0]], j[rows[:, 1]]], axis=1)
        if first > second:
            first, second, rows = second, first, rows[:, ::-1]
        joined.setdefault((first, second), []).append(rows)
    with colmap.Database.open(source) as old, colmap.Database.open(target) as new:
        for camera in old.read_all_cameras():
            new.write_camera(camera, use_camera_id=True)
        numbers = {name: _add_image(colmap, old, new, name, merged[name].xy) for name in merged}
        for (first, second), parts in joined.items():
            rows = merge_matches(parts).astype(np.uint32)
            new.write_matches(numbers[first], numbers[second], rows)
    return merged


def _add_image(colmap, old, new, name: str, xy: np.ndarray) -> int:
    """Copy an image into a database, with other keypoints and a rig of its own camera."""
    image = old.read_image_with_name(name)
    sensor = colmap.sensor_t(type=colmap.SensorType.CAMERA, id=image.camera_id)
    rig = new.read_rig_with_sensor(sensor)
    if rig is None:
        rig = colmap.Rig()
        rig.add_ref_sensor(sensor)
        rig.rig_id = new.write_rig(rig)
    number = new.write_image(colmap.Image(name=name, camera_id=image.camera_id))
    frame = colmap.Frame()
    frame.rig_id = rig.rig_id
    frame.add_data_id(colmap.data_t(sensor_id=sensor, id=number))
    new.write_frame(frame)
    new.write_keypoints(number, xy.astype(np.float32))
    return number
