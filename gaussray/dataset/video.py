"""Writes MP4 videos."""

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import av
import av.error
import numpy as np
from av.video.reformatter import ColorRange, Colorspace
from jaxtyping import Array

from gaussray.dataset.images import enlarge, srgb_levels
from gaussray.io.atomic import atomic_path


# Without these options one file in 800 differs from the others of the same pictures, if sides are
# not multiples of 16.
_SAME = "cpu-independent=1:mbtree=0"
# Threads of a video: frames side by side. Slices of one frame need 3 % more space.
_THREADS = 8


def write_video(
    path: Path | str, frames: Iterable[np.ndarray | Array], fps: float | int, *, least: int = 256
) -> None:
    """Write an MP4 video atomically: H.264, or MPEG-4 without libx264, yuv420p.

    Equal pictures give equal files. Odd sides repeat their last row or column.

    Args:
        path: an `.mp4` file.
        frames: pictures [h, w, 3] of one size, linear light or uint8 sRGB levels.
        fps: frames per second.
        least: pictures are enlarged by an integer factor until both sides have this many pixels;
            0 for no enlargement.

    Raises:
        ValueError: there are no frames, sizes differ, or `fps` or the suffix is wrong.
        OSError: the file cannot be written.
    """
    path = Path(path)
    if not 0 < fps < float("inf"):
        raise ValueError(f"fps must be positive and finite, got {fps}.")
    if path.suffix != ".mp4":
        raise ValueError(f"{path}: a video's suffix must be .mp4, got {path.suffix!r}.")
    with atomic_path(path) as partial:
        try:
            with av.open(str(partial), "w", options={"movflags": "faststart"}) as container:
                _encode(path, container, frames, fps, least)
        except (av.error.FFmpegError, OSError) as error:
            raise OSError(f"{path}: the video cannot be written: {error}") from error


def _encode(path, container, frames, fps, least):
    stream, size = None, None
    for image in frames:
        pixels = _even(enlarge(srgb_levels(image), least))
        if stream is None:
            size = pixels.shape
            stream = _stream(container, size, fps)
        if pixels.shape != size:
            raise ValueError(f"{path}: all frames must have one size, got {size}, {pixels.shape}.")
        frame = av.VideoFrame.from_ndarray(pixels, format="rgb24")
        frame = frame.reformat(
            format="yuv420p",
            dst_colorspace=Colorspace.ITU709,
            dst_color_range=ColorRange.MPEG,
        )
        container.mux(stream.encode(frame))
    if stream is None:
        raise ValueError(f"{path}: a video must have at least one frame, got none.")
    container.mux(stream.encode())


def _stream(container, size, fps):
    h264 = "libx264" in av.codecs_available
    options = {"crf": "16", "preset": "medium", "x264-params": _SAME} if h264 else {"qscale": "2"}
    rate = Fraction(fps).limit_denominator(1001)
    stream = container.add_stream("libx264" if h264 else "mpeg4", rate=rate, options=options)
    stream.height, stream.width = size[:2]
    stream.pix_fmt = "yuv420p"
    context = stream.codec_context
    # The number of threads changes the file, so it must not follow from the machine.
    context.thread_count, context.thread_type = _THREADS, "FRAME"
    context.color_range, context.colorspace = 1, 1  # limited range, BT.709
    context.color_primaries, context.color_trc = 1, 13  # BT.709, the sRGB curve
    return stream


def _even(image):
    height, width = image.shape[:2]
    if not (height % 2 or width % 2):
        return image
    return np.pad(image, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
