"""Lateral chromatic aberration: a lens images red, green and blue at slightly different sizes."""

from jaxtyping import Array, Float

from gaussray.camera.lens import AbstractLens
from gaussray.camera.principal_point import axis_of


def reference_pixel(
    lens: AbstractLens, pixel: Float[Array, "2"], magnification: Float[Array, ""]
) -> Float[Array, "2"]:
    """Pixel at which `lens` images what one colour images at `pixel`: a + (pixel - a) / m.

    a is the pixel of the optical axis and m the colour's magnification, so the colour's picture is
    m times as large as that of the lens. This is lateral chromatic aberration to first order in the
    distance from the axis; m = 1 is none.

    Args:
        lens: the lens of magnification 1. It must image its own axis.
        pixel: position in the colour's picture (column, row), pixel centres at +0.5.
        magnification: m, above 0, without unit.

    Returns:
        Position (column, row) to pass to `lens.direction`.
    """
    axis = axis_of(lens, pixel.dtype)
    return axis + (pixel - axis) / magnification
