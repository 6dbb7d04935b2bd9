"""Picture files as they are stored: size, pixels, and how alpha is treated."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gaussray.capture.errors import CaptureError
from gaussray.capture.orientation import is_turned, stored_orientation, upright_pixels
from gaussray.capture.videos import frame_of, read_frame, read_video
from gaussray.io.safe.files import opened
from gaussray.io.safe.openimageio import oiio
from gaussray.io.safe.pictures import complaint, open_picture


# How alpha is treated: composited over a grey (0 is black), used as a mask, or dropped (None).
# auto is black, which is what a scene shows where it is empty.
BACKGROUNDS: dict[str, float | None] = {
    "auto": 0.0,
    "black": 0.0,
    "white": 1.0,
    "mask": None,
    "none": None,
}
_PNG_END = b"IEND\xaeB`\x82"
# Values that are decoded at once, so that compositing takes little beside the picture; and rows
# that OpenEXR compresses together at most, of which a block holds a multiple.
_BLOCK, _ROWS = 1 << 20, 64
# Undistortion changes the size of a picture by less than this share.
_UNDISTORTED = 0.03


class StoredPicture(NamedTuple):
    """Values [h, w, 3] in the file's own type, and alpha [h, w] in 0..1 where some of it is below
    1 (else None)."""

    values: np.ndarray
    alpha: np.ndarray | None


def read_stored(path: Path | str, width: int, height: int, background: str = "none") -> np.ndarray:
    """Stored values [h, w, 3] of a picture: uint8 and uint16 as they are, other types as float32.

    Args:
        path: the file, or a frame of a video.
        width: columns that the file must have.
        height: rows that the file must have.
        background: one of BACKGROUNDS. Alpha is composited in the values that the file stores
            (sRGB levels in PNG), as the readers of NeRF and 4DGaussians do.

    Raises:
        CaptureError: the size is another.
        OSError: the file is absent, truncated or no picture.
    """
    return read_with_alpha(path, width, height, background).values


def read_levels(path: Path | str, width: int, height: int) -> np.ndarray:
    """The 8-bit levels [h, w, 3] of a picture or of a frame of a video; deeper ones are rounded.

    Args:
        path: the file, or a frame of a video.
        width: columns that the file must have.
        height: rows that the file must have.

    Raises:
        CaptureError: the size is another, or the file stores no levels.
        OSError: the file is absent, truncated or no picture.
    """
    stored = read_stored(path, width, height)
    if stored.dtype == np.uint8:
        return stored
    if not np.issubdtype(stored.dtype, np.integer):
        raise CaptureError(
            f"{path}: the picture must hold levels of 8 or 16 bits, got floating-point numbers. "
            "Save it with 8 or 16 bits a channel."
        )
    return (stored / np.iinfo(stored.dtype).max * 255 + 0.5).astype(np.uint8)


def read_with_alpha(
    path: Path | str, width: int, height: int, background: str = "none"
) -> StoredPicture:
    """Stored values of a picture, as `read_stored` gives them, and its alpha.

    One that is stored lying, and that its EXIF orientation turns to the size that it must have, is
    turned.

    Args:
        path: the file, or a frame of a video, which has no alpha.
        width: columns that the file must have.
        height: rows that the file must have.
        background: one of BACKGROUNDS: what the values are composited over. The alpha is returned
            for each of them, unless it is 1 everywhere.

    Raises:
        CaptureError: the size is another.
        OSError: the file is absent, truncated or no picture.
    """
    frame = frame_of(Path(path))
    if frame is not None:
        pixels = read_frame(*frame)
        check_size(path, pixels.shape[1::-1], width, height)
        return StoredPicture(pixels, None)
    file = open_image(path)
    spec = file.spec()
    if is_turned(spec, width, height):
        file.close()
        way = stored_orientation(spec)
        values, alpha = read_with_alpha(path, height, width, background)
        return StoredPicture(
            upright_pixels(values, way), None if alpha is None else upright_pixels(alpha, way)
        )
    check_size(path, (spec.width, spec.height), width, height)
    kind = {oiio.UINT8: "uint8", oiio.UINT16: "uint16"}.get(spec.format.basetype, "float32")
    channels = _color_channels(spec)
    color = np.empty((height, width, 3), kind)
    alpha = np.empty((height, width), np.float32) if spec.alpha_channel >= 0 else None
    full = np.iinfo(kind).max if kind != "float32" else 1
    grey = BACKGROUNDS[background]
    straight = bool(spec.get_int_attribute("oiio:UnassociatedAlpha"))
    opaque = True
    for top, block in _row_blocks(Path(path), file, spec):
        place = slice(top, top + len(block))
        color[place] = block[..., channels]
        if alpha is None:
            continue
        share = block[..., spec.alpha_channel] / full
        alpha[place] = share
        if (share < 1).any():
            opaque = False
            if grey is not None:
                color[place] = _over(color[place], share[..., None], grey * full, straight)
    return StoredPicture(color, None if opaque else alpha)


def picture_size(path: Path | str) -> tuple[int, int]:
    """Width and height in pixels of a picture, or of a frame of a video, from the file's header.

    Raises:
        CaptureError: the file is no picture, or the video has no such frame.
    """
    frame = frame_of(Path(path))
    if frame is None:
        spec = open_image(path).spec()
        return spec.width, spec.height
    width, height, frames = read_video(frame[0])
    if frame[1] >= frames:
        raise CaptureError(f"{path}: the video must have that frame, got {frames} frames, from 0.")
    return width, height


def picture_exists(path: Path) -> bool:
    """Whether the file of a picture, or the video of a frame, exists."""
    frame = frame_of(path)
    return (path if frame is None else frame[0]).is_file()


def holds_bytes(path: Path) -> bool:
    """Whether a picture stores 8 bits a channel, from its header; frames of videos do."""
    return bool(frame_of(path)) or open_image(path).spec().format.basetype == oiio.UINT8


def check_size(path: Path | str, size: Sequence[int], width: int, height: int) -> None:
    """Check that a picture has the size that its camera says.

    Args:
        path: the picture, for the message.
        size: width and height of the picture in pixels.
        width: width that it must have.
        height: height that it must have.

    Raises:
        CaptureError: the size is another; the message names the file and both sizes.
    """
    if tuple(size) == (width, height):
        return
    remedy = (
        "Resize the picture, or correct w and h together with fl_x, fl_y, cx and cy, which are in "
        "pixels of that size."
    )
    if all(
        abs(got - said) < _UNDISTORTED * said
        for got, said in zip(size, (width, height), strict=True)
    ):
        remedy = (
            "The camera may be that of an undistorted copy of the picture, which COLMAP makes of "
            "a size a little different: use these copies, or the cameras of the pictures as they "
            "are (capture=colmap where the folder has COLMAP's model of them)."
        )
    raise CaptureError(
        f"{path}: the picture must be w x h = {width} x {height} as its camera says, "
        f"got {size[0]} x {size[1]}. {remedy}"
    )


def open_image(path: Path | str) -> "oiio.ImageInput":
    """A picture file whose header is read; FileNotFoundError, OSError or CaptureError names it."""
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: the picture does not exist.")
    if not path.stat().st_size:
        raise OSError(f"{path}: the file is empty. Copy it again.")
    raw = oiio.ImageSpec()
    # Without it OpenImageIO multiplies straight colours by alpha, and rounds them.
    raw["oiio:UnassociatedAlpha"] = 1
    try:
        return open_picture(path, raw)
    except ValueError as error:
        raise CaptureError(str(error)) from None


def _row_blocks(
    path: Path, file: "oiio.ImageInput", spec: "oiio.ImageSpec"
) -> Iterator[tuple[int, np.ndarray]]:
    """First row and values [rows, w, channels] of one block of a picture after another; a picture
    that is stored in tiles is one block."""
    kind = {oiio.UINT8: "uint8", oiio.UINT16: "uint16"}.get(spec.format.basetype, "float")
    rows = max(_BLOCK // (spec.width * spec.nchannels), 1)
    rows = spec.height if spec.tile_width else -(-rows // _ROWS) * _ROWS
    for top in range(0, spec.height, rows):
        end = min(top + rows, spec.height)
        if spec.tile_width:
            values = file.read_image(kind)
        else:
            # Rows are counted from that of the data window.
            values = file.read_scanlines(
                spec.y + top, spec.y + end, spec.z, 0, spec.nchannels, kind
            )
        # A truncated JPEG still returns pixels, invented below the cut: only the message tells.
        if values is None or file.has_error:
            raise OSError(
                f"{path}: the picture is truncated or corrupt: {complaint(file)}. Copy it again."
            )
        yield top, np.asarray(values).reshape(end - top, spec.width, spec.nchannels)
    file.close()
    if file.format_name() == "png" and _PNG_END not in _last_bytes(path):
        raise OSError(
            f"{path}: the picture is truncated or corrupt: its PNG end chunk is missing. Copy it "
            "again."
        )


def _last_bytes(path: Path) -> bytes:
    with opened(path) as file:
        file.seek(max(file.seek(0, 2) - 4096, 0))
        return file.read()


def _over(color: np.ndarray, alpha: np.ndarray, grey: float, straight: bool) -> np.ndarray:
    """Colours over an even grey, in their own type. Straight colours are not yet multiplied by
    alpha, as in PNG; EXR holds products."""
    result = (alpha if straight else 1) * color.astype(np.float64) + (1 - alpha) * grey
    if np.issubdtype(color.dtype, np.integer):
        result = np.clip(np.round(result), 0, np.iinfo(color.dtype).max)
    return result.astype(color.dtype)


def _color_channels(spec: "oiio.ImageSpec") -> list[int]:
    names = [name.upper() for name in spec.channelnames]
    if {"R", "G", "B"} <= set(names):
        return [names.index(name) for name in "RGB"]
    rest = [k for k in range(spec.nchannels) if k != spec.alpha_channel]
    return rest[:3] if len(rest) >= 3 else [rest[0]] * 3
