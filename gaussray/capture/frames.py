"""Pictures from disk: linear light, or the sRGB values that the files hold."""

import warnings
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
import OpenImageIO as oiio
from jaxtyping import Bool, Float, UInt8

from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.color import srgb_decode, srgb_encode


COLOR_SPACES = ("srgb", "linear")
# What a picture with alpha is composited over; "none" drops alpha with a warning.
BACKGROUNDS = {"none": None, "black": 0.0, "white": 1.0}
_PNG_END = b"IEND\xaeB`\x82"


@runtime_checkable
class Picture(Protocol):
    """What is read from a view: where its picture lies, how large it has to be, and what is behind
    it (one of BACKGROUNDS)."""

    @property
    def image(self) -> Path: ...
    @property
    def width(self) -> int: ...
    @property
    def height(self) -> int: ...
    @property
    def color_space(self) -> str: ...
    @property
    def background(self) -> str: ...


def read_image(
    path: Path | str, width: int, height: int, color_space: str = "srgb"
) -> Float[np.ndarray, "h w 3"]:
    """Linear light of a picture.

    Integer files (PNG, JPEG: 8 or 16 bit) hold values of `color_space`, float files (EXR) linear
    light.

    Gray becomes three equal channels. Alpha is dropped with a warning where it is below 1: the
    colours are taken as the file stores them.
    """
    stored = read_stored(path, width, height)
    if not np.issubdtype(stored.dtype, np.integer):
        return stored.astype(np.float32)
    codes = np.arange(np.iinfo(stored.dtype).max + 1, dtype=np.float64) / np.iinfo(stored.dtype).max
    table = codes if _checked(color_space) == "linear" else srgb_decode(codes)
    return table.astype(np.float32)[stored]


def read_encoded(view: Picture) -> np.ndarray:
    """sRGB values [h, w, 3] of a view: the bytes of an 8-bit sRGB file, else float32 (0..1)."""
    stored = read_stored(view.image, view.width, view.height, view.background)
    integers = np.issubdtype(stored.dtype, np.integer)
    if integers and _checked(view.color_space) == "srgb":
        if stored.dtype == np.uint8:
            return stored
        return (stored / np.iinfo(stored.dtype).max).astype(np.float32)
    linear = stored / np.iinfo(stored.dtype).max if integers else stored.astype(np.float64)
    return srgb_encode(linear).astype(np.float32)


def read_codes(view: Picture) -> UInt8[np.ndarray, "h w 3"]:
    """Stored bytes of an 8-bit sRGB picture; any other kind of file is an error."""
    codes = read_encoded(view)
    if codes.dtype != np.uint8:
        raise CaptureError(
            f"{view.image}: the file must be 8-bit sRGB, got another bit depth or colour space. "
            "read_encoded accepts every kind."
        )
    return codes


def load_encoded(
    views: Sequence[Picture], progress: Callable[[int, int], object] | None = None
) -> np.ndarray:
    """sRGB values of many views of one size, [n, h, w, 3]: uint8 if all the files are 8-bit sRGB,
    else float32 in 0..1. `progress(done, total)` is called after each.
    """
    if not views:
        raise CaptureError("the views to load must be at least one, got none.")
    first = views[0]
    for view in views:
        if (view.width, view.height) != (first.width, first.height):
            raise CaptureError(
                f"{view.image}: all views loaded together must have one size, "
                f"got {view.width} x {view.height} after {first.width} x {first.height} "
                f"({first.image}). Load each size by itself."
            )
    stack = np.empty((len(views), first.height, first.width, 3), np.uint8)
    with ThreadPoolExecutor(4) as pool:
        jobs = deque(pool.submit(read_encoded, view) for view in views)
        try:
            for done in range(len(views)):
                values = jobs.popleft().result()
                if values.dtype != stack.dtype and stack.dtype == np.uint8:
                    stack = (stack / 255).astype(np.float32)
                widen = values.dtype == np.uint8 and stack.dtype != np.uint8
                stack[done] = values / 255 if widen else values
                if progress is not None:
                    progress(done + 1, len(views))
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return stack


def read_mask(path: Path | str, width: int, height: int) -> Bool[np.ndarray, "h w"]:
    """True where the mask is white (at least half of full scale in its brightest channel): pixels
    that count. Black is ignored, as in nerfstudio."""
    stored = read_stored(path, width, height)
    full = np.iinfo(stored.dtype).max if np.issubdtype(stored.dtype, np.integer) else 1
    return stored.max(axis=-1) >= full / 2


def check_images(views: Sequence[Picture]) -> None:
    """Raise at once, naming every picture that is absent or whose header disagrees in size."""
    wrong = []
    for view in views:
        try:
            spec = _open(view.image).spec()
            _check_size(view.image, spec, view.width, view.height)
        except (OSError, CaptureError) as error:
            wrong.append(str(error))
    if wrong:
        more = [f"... and {len(wrong) - 10} more"] if len(wrong) > 10 else []
        raise CaptureError(
            "\n".join([f"{len(wrong)} of {len(views)} pictures:", *wrong[:10], *more])
        )


def picture_size(path: Path | str) -> tuple[int, int]:
    """Width and height of a picture in pixels, from its header."""
    spec = _open(path).spec()
    return spec.width, spec.height


def _checked(color_space):
    if color_space not in COLOR_SPACES:
        raise CaptureError(
            f"color_space must be one of {', '.join(COLOR_SPACES)}, got {color_space!r}."
        )
    return color_space


def _open(path):
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: the picture does not exist.")
    raw = oiio.ImageSpec()
    raw["oiio:UnassociatedAlpha"] = 1  # else straight colours come multiplied by alpha, and rounded
    file = oiio.ImageInput.open(str(path), raw)
    if file is None:
        raise OSError(f"{path}: the picture cannot be opened: {oiio.geterror()}")
    return file


def _check_size(path, spec, width, height):
    if (spec.width, spec.height) != (width, height):
        raise CaptureError(
            f"{path}: the picture must be w x h = {width} x {height} as its camera says, "
            f"got {spec.width} x {spec.height}. Correct w and h, or resize the picture."
        )


def read_stored(path: Path | str, width: int, height: int, background: str = "none") -> np.ndarray:
    """Stored values [h, w, 3]: uint8 and uint16 as they are, everything else float32.

    A picture with alpha is composited over the `background`, one of BACKGROUNDS, in the values that
    the file stores (sRGB codes in PNG), as NeRF's and 4DGaussians' readers do.
    """
    file = _open(path)
    spec = file.spec()
    _check_size(path, spec, width, height)
    kind = {oiio.UINT8: "uint8", oiio.UINT16: "uint16"}.get(spec.format.basetype, "float")
    pixels = file.read_image(kind)
    # A truncated JPEG still returns pixels, invented below the cut: only the message tells.
    if pixels is None or file.has_error:
        raise OSError(f"{path}: the picture is truncated or corrupt: {file.geterror()}")
    file.close()
    if file.format_name() == "png" and _PNG_END not in Path(path).read_bytes()[-4096:]:
        raise OSError(f"{path}: the picture is truncated or corrupt: its PNG end chunk is missing")
    pixels = np.asarray(pixels).reshape(height, width, -1)
    color = np.ascontiguousarray(pixels[..., _color_channels(spec)])
    if spec.alpha_channel >= 0:
        full = np.iinfo(pixels.dtype).max if np.issubdtype(pixels.dtype, np.integer) else 1
        alpha = pixels[..., spec.alpha_channel, None]
        light = BACKGROUNDS[background]
        if light is not None:
            straight = bool(spec.get_int_attribute("oiio:UnassociatedAlpha"))
            return _over(color, alpha / full, light * full, straight)
        if (alpha < full).any():
            warnings.warn(
                f"{path}: the alpha channel is ignored, and some of it is below 1. Composite the "
                "picture over its background (capture.background=black or white) to make it count.",
                CaptureWarning,
                stacklevel=3,
            )
    return color


def _over(color, alpha, light, straight):
    """The colours over an even background, in their own type; `straight` are not yet times alpha,
    as in PNG, while EXR holds products."""
    result = (alpha if straight else 1) * color.astype(np.float64) + (1 - alpha) * light
    if np.issubdtype(color.dtype, np.integer):
        result = np.clip(np.round(result), 0, np.iinfo(color.dtype).max)
    return result.astype(color.dtype)


def _color_channels(spec):
    names = [name.upper() for name in spec.channelnames]
    if {"R", "G", "B"} <= set(names):
        return [names.index(name) for name in "RGB"]
    rest = [k for k in range(spec.nchannels) if k != spec.alpha_channel]
    return rest[:3] if len(rest) >= 3 else [rest[0]] * 3
