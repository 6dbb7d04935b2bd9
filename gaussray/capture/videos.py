"""Reads frames of untrusted video files, in order, one at a time."""

import contextlib
import functools
import threading
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from stat import S_ISREG
from typing import Any, NamedTuple

import av
import av.error
import numpy as np
from jaxtyping import UInt8

from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.high_dynamic_range import curve_of, frame_levels
from gaussray.io.safe.limits import limits, within
from gaussray.runtime.progress import Progress


VIDEO_SUFFIXES = (
    *(".mp4", ".mov", ".mkv", ".avi", ".webm"),
    *(".m4v", ".3gp", ".mts", ".m2ts", ".mpg", ".mpeg", ".lrv"),
)

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


class Video(NamedTuple):
    """Size of the upright picture in pixels, and how many frames there are."""

    width: int
    height: int
    frames: int


def frame_path(video: Path, index: int) -> Path:
    """The path that stands for a frame of a video, as if the video were a folder of pictures.

    Args:
        video: file of the video.
        index: number of the frame, from 0.
    """
    return video / f"{index:04d}"


def frame_of(path: Path) -> tuple[Path, int] | None:
    """Video and index of a `frame_path`; None for any other path."""
    number = path.name.isascii() and path.name.isdigit()
    return (path.parent, int(path.name)) if number and is_video(path.parent) else None


def is_video(path: Path) -> bool:
    """Whether the name is that of a video."""
    return path.suffix.lower() in VIDEO_SUFFIXES


def read_video(path: Path | str) -> Video:
    """Size and number of frames of a video.

    All packets are read, and one frame is decoded. Frames must be evenly spaced in time, to a
    quarter of their interval.

    Raises:
        CaptureError: the frames are not evenly spaced, or the file has no pictures, or is turned
            by other than quarters of a turn.
        OSError: the file is absent, damaged, or shorter than its header says.
    """
    return _facts(*_identity(Path(path)))


def decode_frames(path: Path | str, indices: Sequence[int]) -> Iterator[UInt8[np.ndarray, "h w 3"]]:
    """Some frames of a video, upright 8-bit sRGB levels, one at a time.

    The file's own matrix and range of colours count; BT.601 and limited range where it names none,
    as in ffmpeg. High dynamic range is mapped to sRGB (`high_dynamic_range`).

    Args:
        path: file of the video.
        indices: numbers of the frames, from 0, ascending: an earlier one starts the video again.

    Raises:
        CaptureError: the video is refused as in `read_video`, or has no frame of that number.
        OSError: the file is absent or damaged.
    """
    player = _Player(Path(path))
    for index in indices:
        yield player.show(index)


def read_frame(path: Path | str, index: int) -> UInt8[np.ndarray, "h w 3"]:
    """One frame, as `decode_frames` gives it.

    A frame after the last one that was read is decoded from there on; for an earlier one the video
    starts again.

    Args:
        path: file of the video.
        index: number of the frame, from 0.
    """
    return _player(*_identity(Path(path))).show(index)


def _identity(path):
    try:
        stat = path.stat()
    except OSError:
        raise FileNotFoundError(f"{path}: the video does not exist.") from None
    if not S_ISREG(stat.st_mode):
        raise OSError(f"{path}: the video must be a file, got a folder, a pipe or a device.")
    return path, stat.st_mtime_ns, stat.st_size


@functools.lru_cache(maxsize=256)
def _facts(path: Path, changed: int, size: int) -> Video:
    with open_video(path) as container:
        stream = video_stream(path, container)
        packets, listed, first = [], 0, None
        for packet in container.demux(stream):
            if packet.is_corrupt:
                raise _broken(path, f"packet {listed} is incomplete")
            if packet.size:
                listed += 1
            if listed > limits().frames:
                raise CaptureError(
                    f"{path}: the frames must be at most limits.frames={limits().frames}. Raise "
                    "the limit if you trust the file."
                )
            if packet.size and not packet.is_discard:
                packets.append((packet.dts if packet.pts is None else packet.pts, packet.size))
            if first is None:
                first = next(iter(packet.decode()), None)
        if first is None or listed < stream.frames:
            more = f" of {stream.frames}" if stream.frames else ""
            raise _broken(path, f"it holds {listed}{more} frames")
        times = picture_ticks(path, stream.codec_context.name, packets)
        _check_even(path, times)
        if curve := curve_of(first):
            warnings.warn(
                f"{path}: the video is in high dynamic range ({curve}); it is mapped to sRGB, and "
                "bright light is compressed.",
                CaptureWarning,
                stacklevel=2,
            )
        if not stream.frames and len(container.streams) == 1 and container.duration:
            last, step = max(times), (max(times) - min(times)) / max(len(times) - 1, 1)
            if float((last + 3 * step) * stream.time_base) < container.duration / av.time_base:
                raise _broken(path, "it ends before its header says")
        height, width = upright(path, first).shape[:2]
        return Video(width, height, len(times))


# Most bytes of an MPEG-4 packet without a coded picture, and of one without a picture's header.
_PLACEHOLDER, _FILLER = 19, 2


def picture_ticks(path: Path, codec: str, packets: Sequence[tuple[int | None, int]]) -> list[int]:
    """The tick at which each picture of a video is shown, in ascending order.

    MPEG-4 packets may hold no picture. XviD's encoder writes a byte while it waits for pictures to
    come: pictures then follow at one interval, and the last ticks are of none. A picture that is
    not coded is the one before once more, unless an earlier packet held two: what is decoded tells.

    Args:
        path: file of the video.
        codec: name of its decoder.
        packets: tick and bytes of each packet.

    Raises:
        OSError: A packet has no tick, or pictures are missing for other reasons.
    """
    ticks = sorted(tick for tick, _ in packets if tick is not None)
    if len(ticks) < len(packets):
        raise _broken(path, "its frames have no times")
    if codec != "mpeg4" or min((size for _, size in packets), default=_PLACEHOLDER) > _PLACEHOLDER:
        return ticks
    count = _decoded_count(*_identity(path), len(packets))
    missing = len(ticks) - count - sum(size <= _FILLER for _, size in packets)
    # A picture that is not coded has the fewest bytes.
    small = sorted((size, tick) for tick, size in packets if _FILLER < size <= _PLACEHOLDER)
    if missing > len(small):
        raise _broken(path, f"{count} of {len(ticks)} frames can be decoded")
    repeats = {tick for _, tick in small[: max(missing, 0)]}
    return [tick for tick in ticks if tick not in repeats][:count]


@functools.lru_cache(maxsize=256)
def _decoded_count(path: Path, changed: int, size: int, packets: int) -> int:
    """How many pictures the decoder gives."""
    progress, count = Progress(f"frames of {path.name}", packets, patience=2.0), 0
    for count, _ in enumerate(decoded_frames(path), 1):
        progress.report(min(count, packets - 1))
    progress.report(packets)
    return count


def _check_even(path, times):
    steps = np.diff(np.sort(np.array(times, np.float64)))
    usual = float(np.median(steps)) if len(steps) else 0.0
    uneven = np.abs(steps - usual)
    if len(steps) and uneven.max() > usual / 4:
        k = int(np.argmax(uneven))
        raise CaptureError(
            f"{path}: the frames of a video must be evenly spaced in time, got {steps[k]:g} ticks "
            f"after frame {k} and {usual:g} elsewhere. Make the rate constant, e.g. "
            "`ffmpeg -i IN -vf fps=30 OUT`."
        )


class _Player:
    """Goes forward through a video, and starts again for an earlier frame."""

    def __init__(self, path: Path):
        self._path, self._video, self._lock = path, read_video(path), threading.Lock()
        self._frames, self._place, self._last = iter(()), -1, None

    def show(self, index: int) -> UInt8[np.ndarray, "h w 3"]:
        if not 0 <= index < self._video.frames:
            raise CaptureError(
                f"{self._path}: the index of a frame must be in 0 ... {self._video.frames - 1}, "
                f"got {index}."
            )
        with self._lock:
            if self._last is None or index < self._place:
                self._frames, self._place = decoded_frames(self._path), -1
            while self._place < index:
                self._last = next(self._frames, None)
                if self._last is None:
                    raise _broken(self._path, f"frame {self._place + 1} cannot be decoded")
                self._place += 1
            return upright(self._path, self._last)


@functools.lru_cache(maxsize=4)
def _player(path: Path, changed: int, size: int) -> _Player:
    return _Player(path)


def decoded_frames(path: Path) -> Iterator[Any]:
    """All frames of a video, as PyAV gives them, in the order in which they are shown."""
    with open_video(path) as container:
        stream = video_stream(path, container)
        stream.thread_type = "AUTO"
        for place, frame in enumerate(container.decode(stream)):
            if frame.is_corrupt:
                raise _broken(path, f"frame {place} is damaged")
            yield frame


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
        raise _broken(path, error.strerror or type(error).__name__) from error


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


def _broken(path, reason):
    return OSError(f"{path}: the video is truncated or corrupt: {reason}. Copy or encode it again.")
