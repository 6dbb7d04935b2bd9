"""Pictures of views: linear light, or the sRGB values that the files store, and masks."""

import functools
import warnings
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from gaussray.capture.capture import View
from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.picture_file import StoredPicture, picture_size, read_stored, read_with_alpha
from gaussray.capture.stored_part import Window, averaged
from gaussray.capture.videos import frame_of
from gaussray.capture.view_file import PictureFile, shown_size, stored_size
from gaussray.color import srgb_decode, srgb_encode


COLOR_SPACES = ("srgb", "linear")
# Linear light from which on a TIFF file surely holds levels; white is 1.
_BRIGHTEST = 64.0
# What becomes of alpha below 1, by `background`.
ALPHA_USE = {
    "auto": "is composited over black. capture.background=white, mask or none treats it otherwise",
    "none": "is ignored. capture.background=black, white or mask makes it count",
}


def read_image(
    path: Path | str, width: int, height: int, color_space: str = "srgb"
) -> Float[np.ndarray, "h w 3"]:
    """Linear light [height, width, 3] of a picture, as float32.

    Grey becomes three equal channels; alpha is ignored.

    Args:
        path: the file, or a frame of a video (`videos.frame_path`).
        width: columns that the file must have.
        height: rows that the file must have.
        color_space: of integer files (PNG, JPEG), `srgb` or `linear`; float files (EXR) always hold
            linear light.

    Raises:
        CaptureError: the file has another size, or the colour space is unknown.
        OSError: the file is absent, truncated or no picture.
    """
    return _light(read_stored(path, width, height), color_space)


def read_encoded(view: PictureFile) -> np.ndarray:
    """sRGB values [h, w, 3] of a view: uint8 if its file is 8-bit sRGB, else float32 in 0..1.

    Where a view is smaller than the part of the file that it shows, each of its pixels is the mean
    over its area in linear light, as a sensor of larger pixels sees it; bytes are rounded. Its
    margin is black.
    """
    return _encoded(view, stored_picture(view))


def read_with_mask(
    view: View, *, quiet: bool = False
) -> tuple[np.ndarray, Bool[np.ndarray, "h w"] | None]:
    """The sRGB values of a view (`read_encoded`) and its pixels that count (`visible_pixels`; None:
    all), of one reading of its file.

    Args:
        view: the view.
        quiet: whether there is no warning of alpha below 1.
    """
    stored = stored_picture(view)
    shown = None
    if is_masked(view):
        shown = _visible(view, stored.alpha if view.background == "mask" else None)
    return encoded_values(view, stored.values) if quiet else _encoded(view, stored), shown


def _encoded(view: PictureFile, stored: StoredPicture) -> np.ndarray:
    if stored.alpha is not None and view.background in ALPHA_USE:
        # Without a file name: the same text is shown once, not for each picture.
        warnings.warn(
            f"alpha below 1 in pictures {ALPHA_USE[view.background]}.", CaptureWarning, stacklevel=3
        )
    return encoded_values(view, stored.values)


def stored_picture(view: PictureFile) -> StoredPicture:
    """What the file of a view holds."""
    return read_with_alpha(view.image, *stored_size(view), view.background)


# Sides in pixels below which a mask of another size tells nothing of a picture.
_LEAST_MASK = 8


def read_mask(
    path: Path | str, width: int, height: int, window: Window | None = None
) -> Bool[np.ndarray, "h w"]:
    """Pixels that count: True where a mask is white, as in nerfstudio.

    White is at least half of full scale in the brightest channel. Where some pixels of the mask are
    rather transparent and some rather opaque, as in a picture of an object that was cut out, those
    that are opaque count instead. Where the result has another size than the part of the file that
    it shows, means over its pixels' areas are compared.

    Args:
        path: file of the mask. One of another size than its picture, but of the same aspect ratio,
            up to a pixel, is brought to that size: each pixel is that of the nearest one.
        width: columns of the result.
        height: rows of the result.
        window: the part of the picture that is shown; None if the picture has the size of the
            result.

    Raises:
        CaptureError: the mask has another aspect ratio than its picture.
        OSError: the file is absent, truncated or no picture.
    """
    stored = _stored_mask(path, *(window.size if window else (width, height)))
    full = np.iinfo(stored.dtype).max if np.issubdtype(stored.dtype, np.integer) else 1
    shown = window.cut(stored) if window else stored
    # Faster than a maximum along the last, short axis.
    brightest = functools.reduce(np.maximum, np.moveaxis(shown, -1, 0))
    if brightest.shape != (height, width):
        brightest = averaged(brightest[..., None] / full, width, height)[..., 0]
        return brightest >= 0.5
    return brightest >= 0.5 * full


def _stored_mask(path: Path | str, width: int, height: int) -> np.ndarray:
    """The values [height, width, c] of a mask, which may be stored at another size."""
    try:
        return mask_values(path, width, height)
    except CaptureError:
        columns, rows = picture_size(path)
    apart = abs(columns * height - rows * width) > max(columns, rows, width, height)
    if apart or min(columns, rows) < min(_LEAST_MASK, width, height):
        raise CaptureError(
            f"{path}: the mask must be w x h = {width} x {height} as its picture is, or have the "
            f"same aspect ratio, got {columns} x {rows}. Make a mask of the whole picture, or take "
            "it away."
        )
    values = mask_values(path, columns, rows)
    row = (2 * np.arange(height) + 1) * rows // (2 * height)
    column = (2 * np.arange(width) + 1) * columns // (2 * width)
    return values[row[:, None], column]


def mask_values(path: Path | str, width: int, height: int) -> np.ndarray:
    """The colours [height, width, 3] of a mask, or its alpha [..., 1] if that tells pixels apart.

    Args:
        path: file of the mask.
        width: columns that it must have.
        height: rows that it must have.
    """
    values, alpha = read_with_alpha(path, width, height)
    if alpha is None or not alpha.min() < 0.5 <= alpha.max():
        return values
    return alpha[..., None]


def is_masked(view: View) -> bool:
    """Whether some pixels of a view may not count: it has a mask, or its alpha is one, or a margin
    is around it."""
    return view.mask is not None or view.background == "mask" or any(view.margin)


def visible_pixels(view: View) -> Bool[np.ndarray, "h w"]:
    """Pixels of a view that count, by its mask and, with `background` mask, by its alpha; none of
    its margin does."""
    # Frames of videos have no alpha.
    by_alpha = view.background == "mask" and frame_of(view.image) is None
    return _visible(view, stored_picture(view).alpha if by_alpha else None)


def _visible(view: View, alpha: np.ndarray | None) -> Bool[np.ndarray, "h w"]:
    """`visible_pixels`, with the stored alpha that is a mask; None if none is."""
    width, height = shown_size(view)
    visible = np.ones((height, width), bool)
    if view.mask is not None:
        visible &= read_mask(view.mask, width, height, view.window)
    if alpha is not None:
        opaque = (alpha >= 0.5)[..., None].astype(np.float32)
        opaque = view.window.cut(opaque) if view.window else opaque
        if opaque.shape[:2] != visible.shape:
            opaque = averaged(opaque, width, height)
        visible &= opaque[..., 0] >= 0.5
    return _with_margin(view, visible)


def _with_margin(view: PictureFile, shown: np.ndarray) -> np.ndarray:
    """What a view shows, [h, w, ...], with zeros around it."""
    if not any(view.margin):
        return shown
    left, top, right, bottom = view.margin
    around = ((top, bottom), (left, right), *((0, 0),) * (shown.ndim - 2))
    return np.pad(shown, around)


def encoded_values(view: PictureFile, stored: np.ndarray) -> np.ndarray:
    """What `read_encoded` returns of the values that a view's file holds.

    Args:
        view: the view.
        stored: the values [height, width, c] of its file.
    """
    return _with_margin(view, _encoded_part(view, stored))


def _encoded_part(view: PictureFile, stored: np.ndarray) -> np.ndarray:
    part = view.window.cut(stored) if view.window else stored
    width, height = shown_size(view)
    integers = np.issubdtype(part.dtype, np.integer)
    srgb = integers and _checked(view.color_space) == "srgb"
    bytes_stay = srgb and part.dtype == np.uint8
    if part.shape[:2] != (height, width):
        light = averaged(_light(part, view.color_space), width, height)
        values = srgb_encode(light.astype(np.float64))
        if bytes_stay:
            return np.floor(255 * values + 0.5).astype(np.uint8)
        return values.astype(np.float32)
    if bytes_stay:
        return part
    if not integers:
        _check_light(view, part)
        return srgb_encode(part.astype(np.float64)).astype(np.float32)
    levels = np.iinfo(part.dtype).max
    table = np.arange(levels + 1) / levels
    return (table if srgb else srgb_encode(table)).astype(np.float32)[part]


def _check_light(view: PictureFile, stored: np.ndarray) -> None:
    """Refuse levels that a TIFF file stores as floating-point numbers: these are linear light."""
    most = float(stored.max(initial=0))
    if view.image.suffix.lower() in (".tif", ".tiff") and most > _BRIGHTEST:
        raise CaptureError(
            f"{view.image}: a picture of floating-point numbers must hold linear light, 1 for "
            f"white, got values up to {most:.4g}. Save it with 8 or 16 bits a channel."
        )


def _light(stored: np.ndarray, color_space: str) -> np.ndarray:
    """Linear light of stored values, as float32."""
    if not np.issubdtype(stored.dtype, np.integer):
        return stored.astype(np.float32)
    levels = np.iinfo(stored.dtype).max
    values = np.arange(levels + 1, dtype=np.float64) / levels
    table = values if _checked(color_space) == "linear" else srgb_decode(values)
    return table.astype(np.float32)[stored]


def _checked(color_space: str) -> str:
    if color_space not in COLOR_SPACES:
        raise CaptureError(
            f"color_space must be one of {', '.join(COLOR_SPACES)}, got {color_space!r}."
        )
    return color_space
