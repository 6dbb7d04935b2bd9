"""Files with one list of each value, of all cameras: K, R, T, dist, as ZJU-MoCap's and Human3.6M's
JSON have them, mostly without the cameras' names."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gaussray.io.natural_order import natural_order
from gaussray.prepare.calibrations.known_camera import Calibration
from gaussray.prepare.calibrations.stacked_npz import (
    camera_stack,
    has_camera_names,
    stacked_cameras,
)
from gaussray.prepare.calibrations.value_names import VALUE_NAMES, plain_key
from gaussray.prepare.errors import PrepareError
from gaussray.runtime.output import counted
from gaussray.runtime.progress import say


# Objects around the lists, at most.
_DEPTH = 3
# Values of which a file has one for each camera.
_EACH = tuple(
    name for what in ("matrix", "rotation", "translation", "distortion")
    for name in VALUE_NAMES[what]
)  # fmt: skip


# How to name the cameras of a file that has them in an order.
NAMES_REMEDY = (
    'name the cameras in the file: a list "names": ["cam1", "cam2"] beside K, or, of a DLT in .txt '
    "or .csv, a line cam1,cam2 above the columns"
)


def listed_cameras(path: Path, content: Any) -> Calibration | None:
    """The cameras of a file whose lists have one entry for each; None if it has no such lists.

    They lie at the top, or in the only object that has them (`cams: {20190823: {K: ...}}`). Cameras
    without names are those of the input in the natural order of their names (`named_in_order`).

    Args:
        path: the file, for messages.
        content: what it holds.

    Raises:
        PrepareError: Several objects have such lists, one has another length, or numbers make no
            camera.
    """
    found = _with_lists(content, _DEPTH)
    if not found:
        return None
    if len(found) > 1:
        raise PrepareError(
            f"{path}: must hold the lists of one rig, got those of "
            f"{', '.join(found)[:200]}. Write one of them to a file of its own."
        )
    (values,) = found.values()
    arrays = _arrays(path, values)
    if has_camera_names(arrays):
        return stacked_cameras(path, arrays)
    key = camera_stack(arrays)
    assert key is not None
    names = np.array([str(number) for number in range(1, len(arrays[key]) + 1)])
    calibration = stacked_cameras(path, arrays | {"names": names})
    return dataclasses.replace(calibration, in_order=True)


def named_in_order(calibration: Calibration, names: Sequence[str]) -> Calibration:
    """A calibration whose cameras have no names but an order, with those of the input's cameras in
    natural order, and a line that tells it; any other is unchanged.

    Args:
        calibration: the cameras.
        names: names of the input's cameras.

    Raises:
        PrepareError: There are more of one than of the other.
    """
    if not calibration.in_order:
        return calibration
    count, ordered = len(calibration.cameras), sorted(names, key=_natural)
    if count != len(ordered):
        raise PrepareError(
            f"poses.calibration has {counted(count, 'camera')} without names, which are those of "
            f"the input in the order of their names, got {counted(len(ordered), 'camera')} there. "
            f"Give the videos, or the folders of pictures, of all of them, or {NAMES_REMEDY}."
        )
    shown = ordered if count <= 4 else [*ordered[:3], "...", ordered[-1]]
    say(
        f"poses.calibration: its {counted(count, 'camera')} have no names, and are those of the "
        f"input in the order {', '.join(shown)}. Names in the file say another one."
    )
    renamed = [
        dataclasses.replace(camera, name=name)
        for camera, name in zip(calibration.cameras, ordered, strict=True)
    ]
    return dataclasses.replace(calibration, cameras=renamed)


def _natural(name: str) -> Any:
    return natural_order(Path(name))


def _with_lists(content: Any, depth: int, name: str = "the top") -> dict[str, Mapping[str, Any]]:
    """The objects that have a list of several cameras' matrices, by the keys that lead there."""
    if not isinstance(content, Mapping) or not depth:
        return {}
    if any(
        plain_key(key) in VALUE_NAMES["matrix"] and _is_stack(value)
        for key, value in content.items()
    ):
        return {name: content}
    result: dict[str, Mapping[str, Any]] = {}
    for key, inner in content.items():
        result |= _with_lists(inner, depth - 1, str(key))
    return result


def _is_stack(value: Any) -> bool:
    """Whether a value is a list of 3 x 3 lists of numbers."""
    if not isinstance(value, list):
        return False
    try:
        array = np.array(value, np.float64)
    except (ValueError, TypeError, OverflowError):
        return False
    return array.ndim == 3 and array.shape[1:] == (3, 3)


def _arrays(path: Path, values: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """The values as arrays, without those that are none; those of each camera have one length."""
    arrays, counts = {}, {}
    for key, value in values.items():
        is_each = plain_key(key) in _EACH
        try:
            array = np.array(value)
        except ValueError:
            array = np.array(None)
        if array.dtype.kind in "fiuUb":
            arrays[str(key)] = array
        elif is_each and value is not None:
            raise PrepareError(
                f"{path}: {key} must be a list of as many numbers for each camera, got "
                f"{str(value)[:80]}. Correct it."
            )
        if is_each and array.ndim > 1:
            counts[str(key)] = len(array)
    if len(set(counts.values())) > 1:
        listed = ", ".join(f"{count} of {key}" for key, count in counts.items())
        raise PrepareError(
            f"{path}: each list must have one entry for each camera, got {listed}. Add what is "
            "missing."
        )
    return arrays
