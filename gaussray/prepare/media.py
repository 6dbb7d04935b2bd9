"""Pictures and videos of a capture: copied, or decoded to pictures where a reader could not."""

import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gaussray.capture.picture_file import read_levels
from gaussray.capture.video_file import decoded_frames, upright
from gaussray.capture.videos import frame_of, frame_path
from gaussray.dataset.images import write_image
from gaussray.prepare.photographs import copied_photograph, copy_changed, copy_stems
from gaussray.prepare.sources import Source, check_frames
from gaussray.prepare.timeline import Timeline
from gaussray.runtime.progress import Progress


def copy_media(sources: Sequence[Source], timeline: Timeline, out: Path) -> dict[str, list[Path]]:
    """Put the cameras' frames into a capture; videos are copied as they are.

    A video whose frames are not evenly spaced becomes PNG pictures, because readers of captures
    index frames by their number.

    Args:
        sources: the cameras.
        timeline: the frames that are used.
        out: the capture's folder.

    Returns:
        For each camera the file of each timestamp, which may be a frame of a video (`frame_path`).
    """
    progress = Progress("copying", len(sources), patience=2.0)
    files = {}
    for done, source in enumerate(sources, 1):
        index = timeline.frames[source.name]
        if not source.is_video:
            folder, stems = out / "images" / source.name, copy_stems(source.pictures)
            files[source.name] = [
                copied_photograph(source.pictures[i], folder, stems[i]) for i in index
            ]
        elif source.is_even:
            copy = out / "videos" / f"{source.name}{source.path.suffix.lower()}"
            copy_changed(source.path, copy)
            files[source.name] = [frame_path(copy, int(i)) for i in index]
        else:
            files[source.name] = _decode(source, index, out / "images" / source.name)
        progress.report(done)
    return files


def write_matching_pictures(
    files: Sequence[Path],
    index: Sequence[int],
    folder: Path,
    sizes: Sequence[tuple[int, int]],
) -> list[str]:
    """Write the pictures of one camera for COLMAP, as `0003.png` for timestamp 3.

    COLMAP reads files alone, so frames of videos are written as PNG; pictures are copied.

    Args:
        files: the camera's file at each timestamp; it may be a frame of a video (`frame_path`).
        index: timestamps whose pictures are written.
        folder: folder of the camera; made if it does not exist.
        sizes: width and height in pixels of each picture that is written.

    Returns:
        The names of the files in `folder`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    names = []
    for i, size in zip(index, sizes, strict=True):
        suffix = ".png" if frame_of(files[i]) else files[i].suffix.lower()
        name = f"{i:04d}{suffix}"
        if frame_of(files[i]):
            write_image(folder / name, read_levels(files[i], *size))
        else:
            # COLMAP would leave out a broken picture, and the capture would hold it.
            read_levels(files[i], *size)
            shutil.copyfile(files[i], folder / name)
        names.append(name)
    return names


def _decode(source: Source, index: np.ndarray, folder: Path) -> list[Path]:
    needed, count = set(index.tolist()), 0
    for place, frame in enumerate(decoded_frames(source.path)):
        if place in needed:
            write_image(folder / f"{place:05d}.png", upright(source.path, frame))
        count = place + 1
    check_frames(source, count)
    return [folder / f"{i:05d}.png" for i in index]
