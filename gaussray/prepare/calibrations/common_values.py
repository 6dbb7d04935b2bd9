"""What a file says beside its cameras of all of them."""

from collections.abc import Mapping
from typing import Any

from gaussray.prepare.calibrations.distortions import common_distortions, distortions_in
from gaussray.prepare.calibrations.lens_labels import LABEL_MEANINGS, labels_in
from gaussray.prepare.calibrations.opencv_numbers import numbers_under
from gaussray.prepare.calibrations.opencv_pose import pose_direction_labels
from gaussray.prepare.calibrations.picture_sizes import SMALLEST, sides_in, sizes_in
from gaussray.prepare.calibrations.value_names import VALUE_NAMES, plain_key


# Keys that beside cameras are of a chessboard if their numbers are small.
_PLAIN_SIDES = ("width", "height", "w", "h")


def common_values(content: Any) -> dict[str, Any]:
    """What a file says beside its cameras of all: the lens's model and distortion, which way poses
    are, and the size of pictures if it is two whole numbers. A plain `size`, or `width` and
    `height`, of small numbers is a chessboard's, and not of these."""
    if not isinstance(content, Mapping):
        return {}
    labels = labels_in(content)
    labels = {key: value for key, value in labels.items() if not isinstance(value, Mapping)}
    result = {**labels, **common_distortions(content), **pose_direction_labels(content)}
    sizes = sizes_in(content)
    named = {key for key in sizes if plain_key(key) not in ("size", *_PLAIN_SIDES)}
    plain = {key for key in sizes if plain_key(key) == "size"}
    for keys, least in ((named, 1), (plain, SMALLEST), (sizes.keys() - named - plain, SMALLEST)):
        some = {key: value for key, value in sizes.items() if key in keys}
        found = numbers_under(some, VALUE_NAMES["size"], (2,))
        size = [float(side) for side in (sides_in(some) if found is None else found[1])]
        if min(size) >= least and all(side.is_integer() for side in size):
            return {**result, "size": size}
    return result


def with_common(camera: Mapping[str, Any], common: Mapping[str, Any]) -> dict[str, Any]:
    """The values of a camera, and those of all cameras for each meaning (size, distortion, its
    model, the camera's, fisheye, the way of poses) of which it says nothing.

    Args:
        camera: the camera's values by key.
        common: values of all (`common_values`).
    """
    result = dict(camera)
    for names in (sizes_in, distortions_in, pose_direction_labels, *LABEL_MEANINGS):
        own, others = names(camera), names(common)
        if others and not any(map(_is_said, own.values())):
            result = {key: value for key, value in result.items() if key not in own} | others
    return result


def _is_said(value: Any) -> bool:
    return value is not None and not (isinstance(value, str) and not value.strip())
