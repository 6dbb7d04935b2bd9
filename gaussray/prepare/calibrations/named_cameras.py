"""The cameras of a file by their names: of an object or a list, or of one object for each value."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gaussray.prepare.calibrations.camera_values import has_matrix, plain_camera, plain_cameras
from gaussray.prepare.calibrations.common_values import common_values, with_common
from gaussray.prepare.calibrations.known_camera import check_distinct_names
from gaussray.prepare.calibrations.value_names import VALUE_NAMES, plain_key
from gaussray.prepare.errors import PrepareError


# Keys of a list's cameras that hold their names.
CAMERA_NAME_KEYS = (
    *("name", "camera", "cam", "id", "camera_id", "cam_id", "camera_name", "cam_name", "serial"),
)


def named_cameras(path: Path, content: Any) -> dict[str, dict[str, Any]]:
    """The parts of a file that have a camera's matrix, by the camera's name, with what the file
    says of all cameras (`common_values`).

    They are at the top or under `cameras`: the values of an object, the entries of a list with
    names, or an object for each value with that of each camera (`intrinsics: {a: K}`).

    Args:
        path: the file, for messages.
        content: what it holds.

    Raises:
        PrepareError: One of several in a list has no name, two have one, or values of a camera
            contradict each other (`plain_camera`).
    """
    common = common_values(content)
    if isinstance(content, Mapping) and isinstance(content.get("cameras"), Mapping | list):
        content = content["cameras"]
        common |= common_values(content)
    listed = _listed(path, content) or _by_value(path, content)
    return {name: with_common(one, common) for name, one in listed.items()}


def is_by_value(content: Any) -> bool:
    """Whether an object has an object for each value, with that of each camera by its name; two of
    these share a name. Objects that have a lens each are cameras, one of which may be called K."""
    blocks = _blocks(content)
    if all(_makes_camera("", block) for block in blocks.values()):
        return False
    lenses = [block for key, block in blocks.items() if plain_key(key) in VALUE_NAMES["matrix"]]
    return any(
        name in other and plain_key(name) != "matrix" and _makes_camera("K", value)
        for lens in lenses
        for name, value in lens.items()
        for other in blocks.values()
        if other is not lens
    )


def whole_camera(path: Path, content: Any) -> dict[str, Any] | None:
    """The values of an object as those of one camera (`plain_camera`), which may have no matrix;
    None of what is no object, or has an object for each value (`is_by_value`).

    Args:
        path: the file, for messages.
        content: what it holds, or a part of that.

    Raises:
        PrepareError: The values contradict each other.
    """
    if not isinstance(content, Mapping) or is_by_value(content):
        return None
    return plain_camera(path, content)


def _listed(path: Path, content: Any) -> dict[str, dict[str, Any]]:
    """The cameras of an object or a list."""
    if isinstance(content, Mapping):
        if is_by_value(content):
            return {}
        return _with_matrix(path, {str(name): one for name, one in content.items()})
    entries = list(enumerate(content if isinstance(content, list) else [], 1))
    found = plain_cameras(
        {
            str(number): (f"{path}, camera {_said_name(one) or number}", one)
            for number, one in entries
            if isinstance(one, Mapping)
        }
    )
    blocks = {number: camera for number, camera in found.items() if has_matrix(camera)}
    named = []
    for number, one in blocks.items():
        name = _said_name(one)
        if name is None and len(blocks) > 1:
            raise PrepareError(
                f"{path}: camera {number} of the list must have a name "
                f"({', '.join(CAMERA_NAME_KEYS)}), got none. Give each the name of its video."
            )
        named.append((number if name is None else name, one))
    check_distinct_names(path, [name for name, _ in named])
    return dict(named)


def _by_value(path: Path, content: Any) -> dict[str, dict[str, Any]]:
    """The cameras of an object that has an object for each value, with the value of each camera by
    the camera's name: `intrinsics: {a: K}, extrinsics: {a: RT}`."""
    blocks = _blocks(content)
    if not any(plain_key(key) in VALUE_NAMES["matrix"] for key in blocks):
        return {}
    result: dict[str, dict[str, Any]] = {}
    for key, block in blocks.items():
        for name, value in block.items():
            result.setdefault(str(name), {})[key] = value
    return _with_matrix(path, result)


def _with_matrix(path: Path, blocks: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Those of some parts of a file that are of cameras, as `plain_camera` has them."""
    cameras = plain_cameras(
        {
            name: (f"{path}, camera {name}", one)
            for name, one in blocks.items()
            if isinstance(one, Mapping)
        }
    )
    return {name: one for name, one in cameras.items() if has_matrix(one)}


def _blocks(content: Any) -> dict[str, Mapping[str, Any]]:
    """The objects in an object, but for OpenCV's matrices."""
    values = content if isinstance(content, Mapping) else {}
    return {
        str(key): value
        for key, value in values.items()
        if isinstance(value, Mapping) and "data" not in value
    }


def _makes_camera(key: str, value: Any) -> bool:
    """Whether a value is a camera's matrix under its key, or a camera: an object that has one.

    Values that contradict each other (`plain_camera`) are of a camera.
    """
    try:
        return has_matrix(plain_camera("", {key: value})) or (
            isinstance(value, Mapping) and has_matrix(plain_camera("", value))
        )
    except PrepareError:
        return True


def _said_name(camera: Mapping[str, Any]) -> str | None:
    """The name of a camera of a list; None if it has none. A truth value is none."""
    found = (camera[key] for key in CAMERA_NAME_KEYS if type(camera.get(key)) in (str, int))
    return next(map(str, found), None)
