"""Frames of untrusted video files, in order, one at a time."""

import functools
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import av
import numpy as np
from jaxtyping import UInt8

from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.high_dynamic_range import curve_of
from gaussray.capture.video_file import (
    damaged_video,
    decoded_frames,
    open_video,
    upright,
    video_state,
    video_stream,
)
from gaussray.capture.video_times import check_even_ticks, picture_ticks
from gaussray.io.safe.limits import limits


VIDEO_SUFFIXES = (
    *(".mp4", ".mov", ".mkv", ".avi", ".webm"),
    *(".m4v", ".3gp", ".mts", ".m2ts", ".mpg", ".mpeg", ".lrv"),
)


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
    return _facts(*video_state(Path(path)))


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
    for converted in deferred_frames(path, indices):
        yield converted()


def deferred_frames(
    path: Path | str, indices: Sequence[int]
) -> Iterator[Callable[[], UInt8[np.ndarray, "h w 3"]]]:
    """Frames of a video that are decoded, each a function that converts it to what `decode_frames`
    gives, in any thread.

    Args:
        path: file of the video.
        indices: numbers of the frames, as for `decode_frames`.
    """
    player = _Player(Path(path))
    for index in indices:
        yield functools.partial(upright, Path(path), player.frame(index))


def read_frame(path: Path | str, index: int) -> UInt8[np.ndarray, "h w 3"]:
    """One frame, as `decode_frames` gives it.

    A frame after the last one that was read is decoded from there on; for an earlier one the video
    starts again.

    Args:
        path: file of the video.
        index: number of the frame, from 0.
    """
    return _player(*video_state(Path(path))).show(index)


class _Packets(NamedTuple):
    """The packets of a video: how many hold data, tick and bytes of those whose pictures are shown,
    and the first decoded frame."""

    count: int
    shown: list[tuple[int | None, int]]
    first_frame: Any


@functools.lru_cache(maxsize=256)
def _facts(path: Path, changed: int, size: int) -> Video:
    """`read_video` of a file in this state (`video_state`)."""
    with open_video(path) as container:
        stream = video_stream(path, container)
        packets = _read_packets(path, container, stream)
        frame = packets.first_frame
        if frame is None or packets.count < stream.frames:
            more = f" of {stream.frames}" if stream.frames else ""
            raise damaged_video(path, f"it holds {packets.count}{more} frames")
        ticks = picture_ticks(path, stream.codec_context.name, packets.shown)
        check_even_ticks(path, ticks)
        if curve := curve_of(frame):
            warnings.warn(
                f"{path}: the video is in high dynamic range ({curve}); it is mapped to sRGB, and "
                "bright light is compressed.",
                CaptureWarning,
                stacklevel=2,
            )
        _check_end(path, container, stream, ticks)
        height, width = upright(path, frame).shape[:2]
        return Video(width, height, len(ticks))


def _read_packets(path: Path, container: Any, stream: Any) -> _Packets:
    """All packets of a stream of pictures; those after the first frame are not decoded."""
    count, shown, first_frame = 0, [], None
    for packet in container.demux(stream):
        if packet.is_corrupt:
            raise damaged_video(path, f"packet {count} is incomplete")
        if packet.size:
            count += 1
        if count > limits().frames:
            raise CaptureError(
                f"{path}: the frames must be at most limits.frames={limits().frames}. Raise "
                "the limit if you trust the file."
            )
        if packet.size and not packet.is_discard:
            shown.append((packet.dts if packet.pts is None else packet.pts, packet.size))
        if first_frame is None:
            first_frame = next(iter(packet.decode()), None)
    return _Packets(count, shown, first_frame)


def _check_end(path: Path, container: Any, stream: Any, ticks: list[int]) -> None:
    """Refuse a video whose header promises more time, where it gives no number of frames."""
    if stream.frames or len(container.streams) > 1 or not container.duration:
        return
    last, step = max(ticks), (max(ticks) - min(ticks)) / max(len(ticks) - 1, 1)
    if float((last + 3 * step) * stream.time_base) < container.duration / av.time_base:
        raise damaged_video(path, "it ends before its header says")


class _Player:
    """Goes forward through a video, and starts again for an earlier frame."""

    def __init__(self, path: Path):
        self._path, self._video, self._lock = path, read_video(path), threading.Lock()
        self._frames, self._place, self._last = iter(()), -1, None

    def show(self, index: int) -> UInt8[np.ndarray, "h w 3"]:
        return upright(self._path, self.frame(index))

    def frame(self, index: int) -> Any:
        """The frame as PyAV gives it."""
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
                    raise damaged_video(self._path, f"frame {self._place + 1} cannot be decoded")
                self._place += 1
            return self._last


@functools.lru_cache(maxsize=4)
def _player(path: Path, changed: int, size: int) -> _Player:
    """The player of a file in this state (`video_state`), which keeps its place between calls."""
    return _Player(path)
