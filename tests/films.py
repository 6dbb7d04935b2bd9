"""Videos whose frames can be told from each other, and ways to spoil them."""

from fractions import Fraction

import av
import numpy as np
from av.video.reformatter import ColorRange, Colorspace

from gaussray.capture.picture_stream import stream_encoded
from gaussray.dataset.images import write_image


# Grey of frame i is 16 + 12 i: far enough apart for any codec, up to 19 frames.
STEP = 12
CODECS = {".mp4": "libx264", ".mov": "libx264", ".mkv": "libx264", ".avi": "mpeg4"}
CODECS[".webm"] = "libvpx-vp9"


def shades(count=10, width=48, height=32):
    """Even grey frames, the left half of each black."""
    frames = [np.full((height, width, 3), 16 + STEP * i, np.uint8) for i in range(count)]
    for frame in frames:
        frame[:, : width // 2] = 0
    return frames


def load(views):
    """All pictures of `stream_encoded` in one array [n, h, w, 3]."""
    dtype, pictures = stream_encoded(views)
    stack = np.empty((len(views), views[0].height, views[0].width, 3), dtype)
    for place, picture in pictures:
        stack[place] = picture
    return stack


def write_mask(path, mask):
    """A mask as a grey PNG: white counts, black is ignored."""
    write_image(path, np.where(np.asarray(mask), np.uint8(255), np.uint8(0)))


def index_of(picture):
    """Which frame of `shades` a picture shows, by its right half."""
    return round((float(np.mean(picture[:, picture.shape[1] * 3 // 4 :])) - 16) / STEP)


def film(path, frames, *, tags=(1, 1), pts=None, faststart=True):
    """A video of RGB frames at 30 a second, with the range and matrix that the tags (of H.273) name
    (None: limited BT.601 without a word), or each frame at its own tick of 1/90000 s."""
    first = faststart and path.suffix in (".mp4", ".mov")
    with av.open(str(path), "w", options={"movflags": "faststart"} if first else {}) as file:
        stream = file.add_stream(CODECS[path.suffix], rate=30)
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt = "yuv420p"
        if tags:
            stream.codec_context.color_range, stream.codec_context.colorspace = tags
        full, matrix = tags or (1, 5)
        base = Fraction(1, 90000) if pts else Fraction(1, 30)
        stream.codec_context.time_base = base
        for i, pixels in enumerate(frames):
            frame = av.VideoFrame.from_ndarray(pixels, format="rgb24").reformat(
                format="yuv420p",
                dst_colorspace=Colorspace.ITU709 if matrix == 1 else Colorspace.ITU601,
                dst_color_range=ColorRange.JPEG if full == 2 else ColorRange.MPEG,
            )
            frame.pts, frame.time_base = (pts[i] if pts else i), base
            file.mux(stream.encode(frame))
        file.mux(stream.encode())
    return path


def cut(path, share):
    """The first share of a file's bytes (all but so many if negative)."""
    data = path.read_bytes()
    path.write_bytes(data[: share if share < 0 else int(share * len(data))])
    return path


def turn(path, matrix):
    """Write another display matrix (a, b, c, d of ISO 14496-12) into an MP4's track header."""
    data = bytearray(path.read_bytes())
    unit = b"".join(x.to_bytes(4, "big") for x in (0x10000, 0, 0, 0, 0x10000, 0, 0, 0, 0x40000000))
    start = data.index(unit, data.index(b"tkhd"))
    a, b, c, d = (int(x * 0x10000).to_bytes(4, "big", signed=True) for x in matrix)
    zero = bytes(4)
    data[start : start + 36] = b"".join((a, b, zero, c, d, zero, zero, zero, unit[32:]))
    path.write_bytes(data)
    return path
