"""Pictures that are stored lying: a tag of EXIF says how they are seen."""

import numpy as np
from jaxtyping import Shaped

from gaussray.io.safe.openimageio import oiio


# EXIF orientations from which on rows and columns are exchanged.
TRANSPOSED = 5


def stored_orientation(spec: "oiio.ImageSpec") -> int:
    """EXIF's tag 274, 1 to 8: how the stored rows and columns are to be seen; 1 is upright."""
    value = spec.get_int_attribute("Orientation", 1)
    return value if 1 <= value <= 8 else 1


def upright_pixels(
    pixels: Shaped[np.ndarray, "h w *channels"], orientation: int
) -> Shaped[np.ndarray, "u v *channels"]:
    """The pixels of a picture as it is seen.

    Args:
        pixels: rows and columns as they are stored.
        orientation: EXIF's tag 274: 1 is upright, 3 upside down, 6 has its first row at the right
            and 8 at the left; 2, 4, 5 and 7 are mirrored. Others are taken as 1.
    """
    if TRANSPOSED <= orientation <= 8:
        pixels = pixels.swapaxes(0, 1)
    rows = -1 if orientation in (3, 4, 7, 8) else 1
    columns = -1 if orientation in (2, 3, 6, 7) else 1
    return np.ascontiguousarray(pixels[::rows, ::columns])


def is_turned(spec: "oiio.ImageSpec", width: int, height: int) -> bool:
    """Whether a picture is stored lying, and its orientation turns it to a size.

    The cameras of most tools are of the picture as it is seen. COLMAP's are of the picture as it is
    stored, so one that has the size already is never turned.

    Args:
        spec: header of the stored picture.
        width: columns that the picture must have.
        height: rows that the picture must have.
    """
    lying = (spec.width, spec.height) != (width, height) == (spec.height, spec.width)
    return lying and stored_orientation(spec) >= TRANSPOSED
