"""Many pictures, decoded by several threads, of which few are held in memory."""

import functools
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.frames import ALPHA_USE, encoded_values, stored_picture
from gaussray.capture.picture_file import StoredPicture, check_size, holds_bytes
from gaussray.capture.videos import deferred_frames, frame_of
from gaussray.capture.view_file import PictureFile, stored_size
from gaussray.runtime.side_by_side import threads_within


# Pictures that are decoded or averaged at the same time, at least and at most, and the bytes that
# one of them takes for each of its pixels.
_FEWEST, _MOST, _BYTES = 4, 16, 20


def stream_encoded(
    views: Sequence[PictureFile],
    arranged: Callable[[int, np.ndarray], Any] = lambda index, picture: picture,
) -> tuple[np.dtype, Iterator[tuple[int, Any]]]:
    """Pictures of many views of one size, decoded by several threads.

    Every video is decoded once, from its start, and few pictures are held in memory.

    Args:
        views: at least one view.
        arranged: what is made of the picture of each view, of this index, in the thread that
            decodes it.

    Returns:
        The type of all pictures (uint8 if all files are 8-bit sRGB, else float32 in 0..1), and an
        iterator over the index of a view and its sRGB values [h, w, 3], as `arranged` returns them,
        in the order of the files.

    Raises:
        CaptureError: there is no view, or their sizes differ.
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
    dtype = np.dtype(np.uint8 if all(map(_is_bytes, views)) else np.float32)

    def read(index: int, stored: Callable[[], StoredPicture]) -> tuple[Any, bool]:
        values, alpha = stored()
        shown = encoded_values(views[index], values)
        widen = shown.dtype == np.uint8 and dtype != np.uint8
        picture = (shown / 255).astype(dtype) if widen else shown
        return arranged(index, picture), alpha is not None

    return dtype, _streamed(views, read)


def _is_bytes(view: PictureFile) -> bool:
    """Whether `read_encoded` returns uint8, from the file's header."""
    return view.color_space == "srgb" and holds_bytes(view.image)


# Makes what is streamed of the index of a view, and of a function that returns what its file holds;
# tells whether the file has alpha below 1.
_Reading = Callable[[int, Callable[[], StoredPicture]], tuple[Any, bool]]


def _streamed(views: Sequence[PictureFile], read: _Reading) -> Iterator[tuple[int, Any]]:
    transparent, threads = 0, decoding_threads(int(np.prod(stored_size(views[0]))))
    with ThreadPoolExecutor(threads) as pool:
        try:
            for index, (picture, alpha) in _in_order(_jobs(views, read, pool), 2 * threads):
                transparent += alpha and views[index].background in ALPHA_USE
                yield index, picture
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    if transparent:
        warnings.warn(
            f"{transparent} of {len(views)} pictures have alpha below 1, which "
            f"{ALPHA_USE[views[0].background]}.",
            CaptureWarning,
            stacklevel=2,
        )


def decoding_threads(pixels: int) -> int:
    """How many pictures of so many pixels are decoded at the same time."""
    return int(np.clip(threads_within(_BYTES * pixels), _FEWEST, _MOST))


def _jobs(
    views: Sequence[PictureFile], read: _Reading, pool: ThreadPoolExecutor
) -> Iterator[tuple[int, Future]]:
    """Index and future picture of every view, the frames of each video together and in order."""
    videos: dict[Path, dict[int, list[int]]] = {}
    for index, view in enumerate(views):
        frame = frame_of(view.image)
        if frame is None:
            yield index, pool.submit(read, index, functools.partial(stored_picture, view))
        else:
            videos.setdefault(frame[0], {}).setdefault(frame[1], []).append(index)
    for path, frames in videos.items():
        numbers = sorted(frames)
        for number, converted in zip(numbers, deferred_frames(path, numbers), strict=True):
            if len(frames[number]) > 1:
                # A decoded frame is converted by one thread alone.
                converted = functools.partial(np.asarray, converted())
            for index in frames[number]:
                stored = functools.partial(_shown, views[index], converted)
                yield index, pool.submit(read, index, stored)


def _shown(view: PictureFile, converted: Callable[[], np.ndarray]) -> StoredPicture:
    """What a frame of a video holds."""
    levels = converted()
    check_size(view.image, levels.shape[1::-1], *stored_size(view))
    return StoredPicture(levels, None)


def _in_order(
    jobs: Iterable[tuple[int, Future]], ahead: int
) -> Iterator[tuple[int, tuple[Any, bool]]]:
    """The results of jobs in their order, while so many more run."""
    waiting: deque[tuple[int, Future]] = deque()
    for index, job in jobs:
        waiting.append((index, job))
        if len(waiting) > ahead:
            index, job = waiting.popleft()
            yield index, job.result()
    for index, job in waiting:
        yield index, job.result()
