"""The times at which the pictures of a video are shown, in ticks of its clock."""

import functools
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gaussray.capture.errors import CaptureError
from gaussray.capture.video_file import damaged_video, decoded_frames, video_state
from gaussray.runtime.progress import Progress


# An MPEG-4 packet with at most so many bytes may hold no coded picture (it then repeats the one
# before), and one with at most so many holds no picture at all.
_NOT_CODED, _NO_PICTURE = 19, 2
# Intervals between pictures may differ from their median by this share of it.
_TOLERANCE = 0.25


def picture_ticks(path: Path, codec: str, packets: Sequence[tuple[int | None, int]]) -> list[int]:
    """The tick at which each picture of a video is shown, in ascending order.

    MPEG-4 packets may hold no picture. XviD's encoder writes a packet of one byte while it waits
    for pictures; these then follow at one interval, and the last ticks belong to no picture. A
    packet whose picture is not coded shows the picture before it once more, unless an earlier
    packet held two pictures. Only the number of decoded pictures tells these cases apart.

    Args:
        path: file of the video.
        codec: name of its decoder.
        packets: tick and bytes of each packet.

    Raises:
        OSError: A packet has no tick, or pictures are missing for other reasons.
    """
    ticks = sorted(tick for tick, _ in packets if tick is not None)
    if len(ticks) < len(packets):
        raise damaged_video(path, "its frames have no times")
    if codec != "mpeg4" or min((size for _, size in packets), default=_NOT_CODED) > _NOT_CODED:
        return ticks
    count = _decoded_count(*video_state(path), len(packets))
    missing = len(ticks) - count - sum(size <= _NO_PICTURE for _, size in packets)
    # A picture that is not coded has the fewest bytes.
    small = sorted((size, tick) for tick, size in packets if _NO_PICTURE < size <= _NOT_CODED)
    if missing > len(small):
        raise damaged_video(path, f"{count} of {len(ticks)} frames can be decoded")
    repeats = {tick for _, tick in small[: max(missing, 0)]}
    return [tick for tick in ticks if tick not in repeats][:count]


@functools.lru_cache(maxsize=256)
def _decoded_count(path: Path, changed: int, size: int, packets: int) -> int:
    """How many pictures the decoder returns; cached until the file changes."""
    progress, count = Progress(f"frames of {path.name}", packets, patience=2.0), 0
    for count, _ in enumerate(decoded_frames(path), 1):
        progress.report(min(count, packets - 1))
    progress.report(packets)
    return count


def check_even_ticks(path: Path, ticks: Sequence[int]) -> None:
    """Check that pictures are evenly spaced in time, to a quarter of their interval.

    Args:
        path: file of the video, for the message.
        ticks: tick of each picture.

    Raises:
        CaptureError: They are not.
    """
    steps = np.diff(np.sort(np.array(ticks, np.float64)))
    usual = float(np.median(steps)) if len(steps) else 0.0
    deviation = np.abs(steps - usual)
    if len(steps) and deviation.max() > _TOLERANCE * usual:
        k = int(np.argmax(deviation))
        raise CaptureError(
            f"{path}: the frames of a video must be evenly spaced in time, got {steps[k]:g} ticks "
            f"after frame {k} and {usual:g} elsewhere. Make the rate constant, e.g. "
            "`ffmpeg -i IN -vf fps=30 OUT`."
        )
