"""Pictures from disk: linear light, or the sRGB values that the files hold."""

import warnings
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, UInt8

from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.videos import frame_of, read_frame, read_frames, read_video
from gaussray.capture.window import Window, averaged
from gaussray.color import srgb_decode, srgb_encode
from gaussray.io.safe.files import opened
from gaussray.io.safe.openimageio import oiio
from gaussray.io.safe.pictures import complaint, open_picture


COLOR_SPACES = ("srgb", "linear")
# What a picture with alpha is composited over; "none" drops alpha with a warning.
BACKGROUNDS = {"none": None, "black": 0.0, "white": 1.0}
_PNG_END = b"IEND\xaeB`\x82"
# Pictures that are decoded or averaged at the same time, and those that wait their turn.
_THREADS, _AHEAD = 4, 8


@runtime_checkable
class Picture(Protocol):
    """What is read from a view: where its picture lies (a file, or a frame of a video by
    `frame_path`), how large it has to be, what is behind it (one of BACKGROUNDS), and which part of
    the file it is (all of it if None)."""

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
    @property
    def window(self) -> Window | None: ...


def read_image(
    path: Path | str, width: int, height: int, color_space: str = "srgb"
) -> Float[np.ndarray, "h w 3"]:
    """Linear light of a picture.

    Integer files (PNG, JPEG: 8 or 16 bit) hold values of `color_space`, float files (EXR) linear
    light.

    Gray becomes three equal channels. Alpha is dropped with a warning where it is below 1: the
    colours are taken as the file stores them.
    """
    return _light(read_stored(path, width, height), color_space)


def read_encoded(view: Picture) -> np.ndarray:
    """sRGB values [h, w, 3] of a view: bytes if its file is 8-bit sRGB, else float32 (0..1).

    Where a view is smaller than what it shows of the file, each of its pixels is the mean over its
    area in linear light, as a sensor of larger pixels sees it; bytes are rounded to the nearest.
    """
    return _encoded(view, read_stored(view.image, *_stored_size(view), view.background))


def _stored_size(view):
    return view.window.size if view.window else (view.width, view.height)


def _encoded(view, stored):
    part = view.window.cut(stored) if view.window else stored
    integers = np.issubdtype(part.dtype, np.integer)
    srgb = integers and _checked(view.color_space) == "srgb"
    bytes_stay = srgb and part.dtype == np.uint8
    if part.shape[:2] != (view.height, view.width):
        light = averaged(_light(part, view.color_space), view.width, view.height)
        values = srgb_encode(light.astype(np.float64))
        if bytes_stay:
            return np.floor(255 * values + 0.5).astype(np.uint8)
        return values.astype(np.float32)
    if bytes_stay:
        return part
    values = part / np.iinfo(part.dtype).max if integers else part.astype(np.float64)
    return (values if srgb else srgb_encode(values)).astype(np.float32)


def _light(stored, color_space):
    """Linear light of what a file stores, in single precision."""
    if not np.issubdtype(stored.dtype, np.integer):
        return stored.astype(np.float32)
    codes = np.arange(np.iinfo(stored.dtype).max + 1, dtype=np.float64) / np.iinfo(stored.dtype).max
    table = codes if _checked(color_space) == "linear" else srgb_decode(codes)
    return table.astype(np.float32)[stored]


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
    """All pictures of `stream_encoded` in one array [n, h, w, 3]; `progress(done, total)` is called
    after each."""
    dtype, pictures = stream_encoded(views)
    stack = np.empty((len(views), views[0].height, views[0].width, 3), dtype)
    for done, (place, picture) in enumerate(pictures):
        stack[place] = picture
        if progress is not None:
            progress(done + 1, len(views))
    return stack


def stream_encoded(
    views: Sequence[Picture],
) -> tuple[np.dtype, Iterator[tuple[int, np.ndarray]]]:
    """Type and, one at a time, place among the views and sRGB values [h, w, 3] of many views of one
    size: uint8 if all the files are 8-bit sRGB, else float32 in 0..1.

    Every video is decoded once, from its start, and few pictures are held at any time.
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
    dtype = np.dtype(np.uint8 if all(map(_holds_codes, views)) else np.float32)
    return dtype, _streamed(views, dtype)


def _holds_codes(view):
    """Whether `read_encoded` gives bytes, from the file's header."""
    if view.color_space != "srgb":
        return False
    return bool(frame_of(view.image)) or _open(view.image).spec().format.basetype == oiio.UINT8


def _streamed(views, dtype):
    with ThreadPoolExecutor(_THREADS) as pool:
        try:
            for place, values in _in_turn(_reading(views, pool)):
                widen = values.dtype == np.uint8 and dtype != np.uint8
                yield place, (values / 255).astype(dtype) if widen else values
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def _reading(views, pool) -> Iterator[tuple[int, Future]]:
    """Place and picture-to-be of every view, the frames of each video together and in order."""
    videos: dict[Path, list[tuple[int, int]]] = {}
    for place, view in enumerate(views):
        found = frame_of(view.image)
        if found is None:
            yield place, pool.submit(read_encoded, view)
        else:
            videos.setdefault(found[0], []).append((found[1], place))
    for path, frames in videos.items():
        frames.sort()
        pictures = read_frames(path, [index for index, _ in frames])
        for (_, place), stored in zip(frames, pictures, strict=True):
            view = views[place]
            _check_size(view.image, stored.shape[1::-1], *_stored_size(view))
            yield place, pool.submit(_encoded, view, stored)


def _in_turn(jobs):
    """The results of jobs in their order, while a few more are at work."""
    waiting = deque()
    for place, job in jobs:
        waiting.append((place, job))
        if len(waiting) > _AHEAD:
            place, job = waiting.popleft()
            yield place, job.result()
    for place, job in waiting:
        yield place, job.result()


def read_mask(
    path: Path | str, width: int, height: int, window: Window | None = None
) -> Bool[np.ndarray, "h w"]:
    """True where the mask is white (at least half of full scale in its brightest channel): pixels
    that count. Black is ignored, as in nerfstudio. Through a `window`, means are compared."""
    stored = read_stored(path, *(window.size if window else (width, height)))
    full = np.iinfo(stored.dtype).max if np.issubdtype(stored.dtype, np.integer) else 1
    brightest = (window.cut(stored) if window else stored).max(axis=-1, keepdims=True) / full
    if brightest.shape[:2] != (height, width):
        brightest = averaged(brightest, width, height)
    return brightest[..., 0] >= 0.5


def check_images(views: Sequence[Picture]) -> None:
    """Raise at once, naming every picture that is absent or whose header disagrees in size."""
    wrong = []
    for view in views:
        try:
            _check_size(view.image, picture_size(view.image), *_stored_size(view))
        except (OSError, CaptureError) as error:
            wrong.append(str(error))
    if wrong:
        more = [f"... and {len(wrong) - 10} more"] if len(wrong) > 10 else []
        raise CaptureError(
            "\n".join([f"{len(wrong)} of {len(views)} pictures:", *wrong[:10], *more])
        )


def picture_size(path: Path | str) -> tuple[int, int]:
    """Width and height in pixels of a picture, or of a frame of a video, from the file's header."""
    found = frame_of(Path(path))
    if found is None:
        spec = _open(path).spec()
        return spec.width, spec.height
    width, height, frames = read_video(found[0])
    if found[1] >= frames:
        raise CaptureError(f"{path}: the video must have that frame, got {frames} frames, from 0.")
    return width, height


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
    try:
        return open_picture(path, raw)
    except ValueError as error:
        raise CaptureError(str(error)) from None


def _check_size(path, size, width, height):
    if tuple(size) != (width, height):
        raise CaptureError(
            f"{path}: the picture must be w x h = {width} x {height} as its camera says, "
            f"got {size[0]} x {size[1]}. Correct w and h, or resize the picture."
        )


def read_stored(path: Path | str, width: int, height: int, background: str = "none") -> np.ndarray:
    """Stored values [h, w, 3]: uint8 and uint16 as they are, everything else float32.

    A picture with alpha is composited over the `background`, one of BACKGROUNDS, in the values that
    the file stores (sRGB codes in PNG), as NeRF's and 4DGaussians' readers do.
    """
    found = frame_of(Path(path))
    if found is not None:
        pixels = read_frame(*found)
        _check_size(path, pixels.shape[1::-1], width, height)
        return pixels
    file = _open(path)
    spec = file.spec()
    _check_size(path, (spec.width, spec.height), width, height)
    kind = {oiio.UINT8: "uint8", oiio.UINT16: "uint16"}.get(spec.format.basetype, "float")
    pixels = file.read_image(kind)
    # A truncated JPEG still returns pixels, invented below the cut: only the message tells.
    if pixels is None or file.has_error:
        raise OSError(f"{path}: the picture is truncated or corrupt: {complaint(file)}")
    file.close()
    if file.format_name() == "png" and _PNG_END not in _last(Path(path)):
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


def _last(path):
    """The end of a file."""
    with opened(path) as file:
        file.seek(max(file.seek(0, 2) - 4096, 0))
        return file.read()


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
