"""Writes pictures; side-by-side comparisons and contact sheets."""

import errno
import math
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Array, Bool, UInt8

from gaussray.color import srgb_encode
from gaussray.dataset.levels import host_levels, require_finite, srgb_table
from gaussray.io.atomic import atomic_path
from gaussray.io.safe.openimageio import oiio


def srgb_levels(
    image: np.ndarray | Array, encode: Callable[[np.ndarray], np.ndarray | Array] = srgb_encode
) -> np.ndarray:
    """8-bit levels of linear light: encoded, clipped to 0..1 and rounded to nearest.

    Args:
        image: linear light of any shape; uint8 levels are returned as they are.
        encode: transfer curve; the sRGB curve by default.

    Raises:
        ValueError: a value is not finite.
    """
    image = np.asarray(image)
    if image.dtype == np.uint8:
        return image
    require_finite(image.size - int(np.isfinite(image).sum()))
    if encode is srgb_encode and image.dtype in (np.float32, np.float16):
        return host_levels(image.astype(np.float32, copy=False), srgb_table())
    encoded = np.clip(encode(image.astype(np.float64)), 0, 1)
    return np.floor(255 * encoded + 0.5).astype(np.uint8)


def write_image(path: Path | str, image: np.ndarray | Array, *, depth: str = "half") -> None:
    """Write a picture atomically.

    Args:
        path: `.png` for 8-bit sRGB (`srgb_levels`), `.exr` for linear light.
        image: linear light [h, w, 3] or [h, w] (in EXR any number of channels), or uint8 levels.
        depth: of an EXR, half or float.

    Raises:
        ValueError: the picture does not suit the format.
        OSError: the file cannot be written.
    """
    path, image = Path(path), np.asarray(image)
    if path.suffix == ".png":
        _write(path, srgb_levels(image), "uint8")
    elif path.suffix == ".exr":
        if image.dtype == np.uint8:
            raise ValueError(f"{path}: an EXR picture must be linear light, got 8-bit levels.")
        if depth not in ("half", "float"):
            raise ValueError(f"depth must be one of half, float, got {depth!r}.")
        if depth == "float":
            image = image.astype(np.float32, copy=False)
        elif image.dtype != np.float16:
            check_half(path, np.max(np.abs(image), where=np.isfinite(image), initial=0))
            image = image.astype(np.float32, copy=False)
        _write(path, image, depth)
    else:
        raise ValueError(f"{path}: a picture's suffix must be .png or .exr, got {path.suffix!r}.")


def check_half(path: Path, largest: float | np.floating) -> None:
    """Check that half floats can hold a picture.

    Args:
        path: the file, for the message.
        largest: its largest finite magnitude.

    Raises:
        ValueError: They cannot.
    """
    if largest > MOST_HALF:
        raise ValueError(
            f"{path}: a half-float picture must stay within {MOST_HALF}, "
            f"got {largest}. Use depth='float'."
        )


# libpng's number of the Paeth filter. With it and run lengths alone (`rle`), renderings take 31 to
# 43 % of the time of all filters and level 4, and between 13 % less and 0.4 % more space.
_PAETH = 128
# Halves take 8 to 39 % less time than with the usual level 4, and 1 % more space; floats, whose
# last bits are noise, 8 to 46 % less time, and up to 7 % more space.
_ZIP_HALF, _ZIP_FLOAT = "zip:2", "zip:1"
# The largest half float.
MOST_HALF = 65504
# The last chunk of every PNG.
_IEND = b"\0\0\0\0IEND\xaeB`\x82"


def side_by_side(
    truth: np.ndarray | Array,
    ours: np.ndarray | Array,
    shown: Bool[np.ndarray, "h w"] | None = None,
    *,
    gain: float | int = 4,
) -> UInt8[np.ndarray, "h w3 3"]:
    """8-bit levels of two pictures and of their difference in sRGB values, side by side.

    Args:
        truth: the left picture, linear light or 8-bit levels.
        ours: the middle picture, of the same size.
        shown: pixels that count; the difference of all others is 0. None: all count.
        gain: factor of the absolute difference, which is the right picture.

    Raises:
        ValueError: the pictures have different sizes.
    """
    truth, ours = srgb_levels(truth), srgb_levels(ours)
    if truth.shape != ours.shape:
        raise ValueError(f"the pictures must have one size, got {truth.shape} and {ours.shape}.")
    difference = np.abs(truth.astype(np.float64) - ours.astype(np.float64)) * gain
    if shown is not None:
        difference[~shown] = 0
    return np.concatenate([truth, ours, np.clip(difference, 0, 255).astype(np.uint8)], axis=1)


def enlarge(image: np.ndarray, least: int) -> np.ndarray:
    """Enlarge a picture by the smallest sufficient integer factor; pixels are repeated.

    Args:
        image: the picture.
        least: smallest side of the result, in pixels.
    """
    factor = max(1, math.ceil(least / min(image.shape[:2])))
    if factor == 1:
        return image
    return image.repeat(factor, axis=0).repeat(factor, axis=1)


def contact_sheet(
    rows: Sequence[tuple[str, Sequence[np.ndarray | Array]]],
    *,
    titles: Sequence[str] = (),
    least: int = 0,
    font: int = 14,
) -> UInt8[np.ndarray, "h w 3"]:
    """8-bit levels of a table of pictures on white.

    Args:
        rows: label and pictures (linear light or 8-bit levels) of each row.
        titles: titles of the columns.
        least: pictures are enlarged to sides of at least so many pixels.
        font: height of the text in pixels.

    Raises:
        ValueError: there are no rows.
    """
    if not rows:
        raise ValueError("a contact sheet must have at least one row, got none.")
    grid = [[enlarge(srgb_levels(image), least) for image in images] for _, images in rows]
    columns = max(len(images) for images in grid)
    gap = 6
    titled = [*titles, *[""] * columns][:columns]
    widths = [
        max([_text_width(title, font)] + [images[k].shape[1] for images in grid if k < len(images)])
        for k, title in enumerate(titled)
    ]
    heights = [max([font + gap] + [image.shape[0] for image in images]) for images in grid]
    margin = max(_text_width(label, font) for label, _ in rows) + 2 * gap
    top = (font + 2 * gap) if titles else gap
    height = top + sum(heights) + gap * len(rows)
    sheet = np.full((height, margin + sum(widths) + gap * columns, 3), 255, np.uint8)
    lefts = [margin + sum(widths[:k]) + gap * k for k in range(columns)]
    texts = [(left, gap, title) for left, title in zip(lefts, titled, strict=True)]
    for (label, _), images, height in zip(rows, grid, heights, strict=True):
        texts.append((gap, top, label))
        for left, image in zip(lefts, images, strict=False):
            sheet[top : top + image.shape[0], left : left + image.shape[1]] = image
        top += height + gap
    return _with_texts(sheet, texts, font)


def _text_width(text, font):
    """Width of a text in pixels."""
    return max(0, oiio.ImageBufAlgo.text_size(text, font).xend) if text else 0


def _with_texts(sheet, texts, font):
    """The sheet with black texts at (left, top), in OpenImageIO's font."""
    buffer = oiio.ImageBuf(np.ascontiguousarray(sheet))
    for left, top, text in texts:
        if text and not oiio.ImageBufAlgo.render_text(
            buffer, left, top + font, text, font, "", (0.0, 0.0, 0.0)
        ):
            raise OSError(f"the label {text!r} cannot be drawn: {buffer.geterror()}")
    return np.ascontiguousarray(buffer.get_pixels(oiio.UINT8))


def _write(path, image, kind):
    image = image if image.ndim == 3 else image[..., None]
    spec = oiio.ImageSpec(image.shape[1], image.shape[0], image.shape[2], kind)
    spec["oiio:ColorSpace"] = "srgb_rec709_scene" if kind == "uint8" else "lin_rec709_scene"
    write_pixels(path, image, spec)


def write_pixels(path: Path, image: np.ndarray, spec: "oiio.ImageSpec") -> None:
    """Write pixels atomically. Equal pixels give equal files: the date of an EXR is empty.

    Args:
        path: the file.
        image: pixels [h, w, channels].
        spec: size and type of the file.

    Raises:
        OSError: the file cannot be written.
    """
    if path.suffix == ".exr":
        # Otherwise OpenImageIO writes the current date.
        spec["DateTime"] = ""
        spec["compression"] = _ZIP_FLOAT if spec.format == oiio.FLOAT else _ZIP_HALF
    elif spec.format == oiio.UINT8:
        spec["png:filter"], spec["compression"] = _PAETH, "rle"
    with atomic_path(path) as partial:
        file = oiio.ImageOutput.create(str(partial))
        if file is None:
            raise OSError(f"{path}: the picture cannot be written: {oiio.geterror()}")
        written = file.open(str(partial), spec) and file.write_image(np.ascontiguousarray(image))
        written = file.close() and written
        if not written or not _is_complete_png(partial):
            reason = file.geterror() or "the file is truncated"
            full = shutil.disk_usage(path.parent).free < image.nbytes
            cause = OSError(errno.ENOSPC, "No space left on device") if full else None
            raise OSError(f"{path}: the picture cannot be written: {reason}") from cause


def _is_complete_png(path: Path) -> bool:
    """Whether a PNG is complete: on a full disk OpenImageIO truncates it without an error."""
    if path.suffix != ".png":
        return True
    with path.open("rb") as file:
        file.seek(max(path.stat().st_size - len(_IEND), 0))
        return file.read() == _IEND
