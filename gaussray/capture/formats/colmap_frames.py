"""Which frames of several cameras were taken at one time, in a capture of COLMAP."""

from pathlib import Path

from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.frame_numbers import frame_numbers
from gaussray.capture.videos import frame_of


def frames_together(
    folder: Path, frames: dict[str, list[Path]], fixed: bool
) -> tuple[dict[str, list[Path]], list[float] | None]:
    """The frames that all cameras have, and the time of each; None: frame i of n is at i / n.

    Args:
        folder: the capture's folder.
        frames: all frames of each camera.
        fixed: whether all cameras stand still; otherwise only registered pictures are used.
    """
    if any(frame_of(path) for own in frames.values() for path in own[:1]):
        return frames, None
    found = frame_numbers(frames)
    if found.common and not found.is_order and fixed:
        left = {name: len(own) - len(found.common) for name, own in frames.items()}
        listed = ", ".join(f"{count} of {name}" for name, count in left.items() if count)
        Keys(folder, {}).warn(
            "the pictures of the cameras go together by the numbers in their names, of which "
            f"all have {len(found.common)}" + f"; left out are {listed}." * bool(listed)
        )
        if found.from_zero_and_one:
            Keys(folder, {}).warn(
                "pictures of one number are taken to be of one time, but pictures at one place may "
                f"be, as one folder begins with 0 and another with 1: {found.doubt}. If they are, "
                "number the pictures of all folders from the same number on."
            )
        name = next(iter(frames))
        counts = [found.counts(name)[k] for k in found.places(name)]
        times = [(count - counts[0]) / (counts[-1] - counts[0] + 1) for count in counts]
        return {name: [own[k] for k in found.places(name)] for name, own in frames.items()}, times
    if found.doubt and len({len(own) for own in frames.values()}) == 1:
        Keys(folder, {}).warn(
            "pictures at one place in the cameras' folders are taken to be of one time, but by "
            f"the numbers in their names they may not be: {found.doubt}. If they are not, call "
            "pictures of one time alike in all folders."
        )
    return frames, None
