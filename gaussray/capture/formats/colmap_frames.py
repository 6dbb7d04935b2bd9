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
    if found.common and not fixed:
        # Each camera's registered pictures tell its path, so none can be left out.
        found = found._replace(common=[])
    alike = len({len(own) for own in frames.values()}) == 1
    text, remedy = found.open_question
    if text and (found.common or alike):
        Keys(folder, {}).warn(f"{text}. {remedy}")
    if not found.common:
        return frames, None
    left = {name: len(own) - len(found.common) for name, own in frames.items()}
    listed = ", ".join(f"{count} of {name}" for name, count in left.items() if count)
    Keys(folder, {}).warn(
        "the pictures of the cameras go together by the numbers in their names, of which all have "
        f"{len(found.common)}; left out are {listed}."
    )
    first, last = found.common[0], found.common[-1]
    times = [(time - first) / (last - first + 1) for time in found.common]
    return {name: [own[k] for k in found.places(name)] for name, own in frames.items()}, times
