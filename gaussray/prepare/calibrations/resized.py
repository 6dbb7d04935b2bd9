"""A known lens for pictures of another size than those of its calibration."""

import numpy as np

from gaussray.prepare.calibrations.picture_sizes import SMALLEST
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.findings.finding import Finding
from gaussray.prepare.lens_models import LensKeyValues


# A picture may be so much larger or smaller than its calibration without being another one: rows
# and columns that an encoder adds or drops.
_MARGIN = 16
# Quotients of width and height may differ by this share.
_SHAPE = 5e-3
# Principal points of lenses of unknown size are told of if twice their column or row is outside
# these shares of the pictures' width or height.
_MIDDLE = (0.7, 1.4)
# Both shares say one size of the calibration if they differ by at most this part of the larger.
_ALIKE = 0.1
# More columns or rows have no pictures.
_LARGEST = 100_000
_GIVE_SIZE = (
    "Give its size: image_size=[columns, rows] in its file, or size in a .toml (docs/prepare.md)."
)
_CROPPED = (
    "Check that the pictures show all that those of the calibration showed, not a part of it."
)


def resized_lens(
    lens: LensKeyValues, camera: str, size: tuple[int, int], key: str
) -> tuple[LensKeyValues, Finding | None]:
    """A lens for pictures of a size, and a warning if it is of another one.

    It is used as it is if the sizes differ by at most 16 rows and columns, and scaled if the
    pictures have the same shape. One of unknown size is used as it is, with a warning if its
    principal point is far from the middle.

    Args:
        lens: the calibrated lens; `w` and `h` are 0 if its pictures are of unknown size.
        camera: what messages call the camera.
        size: columns and rows of the pictures.
        key: the key that gives the lens, for messages.

    Raises:
        PrepareError: The pictures have another shape.
    """
    if not (lens["w"] or lens["h"]):
        return lens | {"w": size[0], "h": size[1]}, _off_middle(lens, camera, size, key)
    width, height = lens["w"] or size[0], lens["h"] or size[1]
    resized = lens | {"w": size[0], "h": size[1]}
    if (width, height) == size:
        return resized, None
    sizes = f"{width} x {height} for pictures of {size[0]} x {size[1]}"
    text = f"{camera}: the calibration ({key}) is of {sizes}"
    if max(abs(width - size[0]), abs(height - size[1])) <= _MARGIN:
        return resized, Finding("warn", "lens", f"{text}; it is used as it is", _CROPPED)
    scale = np.array([size[0] / width, size[1] / height])
    if abs(scale[0] / scale[1] - 1) > _SHAPE:
        turned = abs(size[0] / height / (size[1] / width) - 1) <= _SHAPE
        remedy = (
            "These pictures are turned: leave them out, or calibrate with pictures turned as they "
            "are."
            if turned
            else "Calibrate at the size of the pictures, or scale the pictures back."
        )
        raise PrepareError(
            f"{camera}: {key} must be of pictures of the same shape, got {sizes}. {remedy}"
        )
    for name, factor in zip(("fl_x", "fl_y", "cx", "cy"), (*scale, *scale), strict=True):
        resized[name] *= float(factor)
    return resized, Finding("warn", "lens", f"{text}; it is scaled", _CROPPED)


def _off_middle(
    lens: LensKeyValues, camera: str, size: tuple[int, int], key: str
) -> Finding | None:
    """A warning if a lens of unknown size may be of another one."""
    shares = 2 * lens["cx"] / size[0], 2 * lens["cy"] / size[1]
    if all(_MIDDLE[0] <= share <= _MIDDLE[1] for share in shares):
        return None
    text = (
        f"{camera}: the calibration ({key}) says no size of its pictures, and its principal point "
        f"is at {lens['cx']:.0f} of {size[0]} columns and {lens['cy']:.0f} of {size[1]} rows"
    )
    sides = [round(round(share, 2) * side) for share, side in zip(shares, size, strict=True)]
    alike = abs(shares[0] - shares[1]) <= _ALIKE * max(shares)
    if alike and min(sides) >= SMALLEST and max(sides) <= _LARGEST:
        remedy = f"Was it calibrated at {sides[0]} x {sides[1]}?"
    else:
        remedy = "Are all numbers in pixels?"
    return Finding("warn", "lens", text, f"{remedy} {_GIVE_SIZE}")
