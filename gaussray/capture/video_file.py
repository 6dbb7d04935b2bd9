"""Untrusted video files: only common codecs are opened, and sizes are checked before decoding."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from stat import S_ISREG
from typing import Any

import av
import av.error
import numpy as np
from jaxtyping import UInt8

from gaussray.capture.errors import CaptureError
from gaussray.capture.high_dynamic_range import frame_levels
from gaussray.io.safe.limits import limits, within


# Decoders of common codecs; FFmpeg has three hundred more.
CODECS = (
    *("h264", "hevc", "av1", "libdav1d", "vp8", "vp9", "libvpx", "libvpx-vp9", "mpeg4"),
    *("mpeg2video", "mjpeg", "png", "ffv1", "prores", "dnxhd", "huffyuv", "ffvhuff", "utvideo"),
    *("qtrle", "rawvideo"),
)
# Decoders of sound tracks.
SOUND_CODECS = (
    *("aac", "mp3", "mp3float", "opus", "libopus", "vorbis", "flac", "alac", "ac3", "amrnb"),
    *("pcm_s16le", "pcm_s16be", "pcm_s24le", "pcm_f32le"),
)
# Without these FFmpeg also opens playlists, which name other files, under the suffix .mp4.
_OPENING: dict[str, Any] = {
    "options": {
        "format_whitelist": "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpegts,mpeg",
        "protocol_whitelist": "file",
    },
    "metadata_errors": "replace",
}


@contextlib.contextmanager
def open_video(path: Path, *, sound: bool = False) -> Iterator[Any]:
    """Open a video with the decoders of `CODECS` only; the block gets PyAV's container.

    Args:
        path: file of the video.
        sound: whether sound tracks may be decoded too, with `SOUND_CODECS`.

    Raises:
        OSError: the file is absent or damaged, also where that shows within the block.
    """
    codecs = (*CODECS, *SOUND_CODECS) if sound else CODECS
    options = {**_OPENING["options"], "codec_whitelist": ",".join(codecs)}
    try:
        with av.open(str(path.absolute()), **{**_OPENING, "options": options}) as container:
            yield container
    except av.error.FFmpegError as error:
        raise damaged_video(path, error.strerror or type(error).__name__) from error


def video_stream(path: Path, container: Any) -> Any:
    """The first stream of pictures of a container, checked before anything is decoded.

    Args:
        path: file of the video, for messages.
        container: the open video, as PyAV gives it (`open_video`).

    Raises:
        CaptureError: there are no pictures, they are larger than `limits.picture`, or their codec
            is not in `CODECS`.
    """
    if not container.streams.video:
        raise CaptureError(
            f"{path}: a video must hold a stream of pictures, got none: it is truncated, or no "
            "video. Copy it again."
        )
    stream = container.streams.video[0]
    codec = stream.codec_context
    if codec is None or codec.name not in CODECS:
        name = "an unknown one" if codec is None else codec.name
        raise CaptureError(
            f"{path}: the frames must be encoded by one of {', '.join(CODECS)}, got {name}. "
            "Encode them anew, e.g. by `ffmpeg -i IN -c:v libx264 OUT.mp4`."
        )
    _check_pixels(path, codec.width * codec.height)
    # Frames that are larger than the header says are not decoded either.
    if not codec.is_open:
        codec.options = {"max_pixels": str(int(1e6 * limits().picture))}
    return stream


def decoded_frames(path: Path) -> Iterator[Any]:
    """All frames of a video, as PyAV gives them, in the order in which they are shown."""
    with open_video(path) as container:
        stream = video_stream(path, container)
        stream.thread_type = "AUTO"
        for index, frame in enumerate(container.decode(stream)):
            if frame.is_corrupt:
                raise damaged_video(path, f"frame {index} is damaged")
            yield frame


def _check_pixels(path, count):
    try:
        within(path, "the megapixels of a frame", count, "picture", 1e6)
    except ValueError as error:
        raise CaptureError(str(error)) from None


def upright(path: Path, frame: Any) -> UInt8[np.ndarray, "h w 3"]:
    """The sRGB levels of a decoded frame, turned as its metadata say.

    Args:
        path: file of the video, for messages.
        frame: the frame, as PyAV gives it.

    Raises:
        CaptureError: the frame is larger than `limits.picture`, or turned by other than quarters.
    """
    _check_pixels(path, frame.width * frame.height)
    pixels = frame_levels(frame)
    if frame.rotation % 90:
        raise CaptureError(
            f"{path}: a video must be turned by quarters of a turn, got {frame.rotation} degrees "
            "in its metadata. Encode it upright."
        )
    # Counterclockwise, as `rot90`.
    return np.ascontiguousarray(np.rot90(pixels, frame.rotation // 90))


def video_state(path: Path) -> tuple[Path, int, int]:
    """Path, time of the last change and bytes of a video: what is cached of it is valid for these.

    Raises:
        OSError: the file does not exist, or is no regular file.
    """
    try:
        stat = path.stat()
    except OSError:
        raise FileNotFoundError(f"{path}: the video does not exist.") from None
    if not S_ISREG(stat.st_mode):
        raise OSError(f"{path}: the video must be a file, got a folder, a pipe or a device.")
    return path, stat.st_mtime_ns, stat.st_size


def damaged_video(path: Path, reason: str) -> OSError:
    """The error of a video that cannot be read as its header says.

    Args:
        path: file of the video.
        reason: what is wrong with it.
    """
    return OSError(f"{path}: the video is truncated or corrupt: {reason}. Copy or encode it again.")
