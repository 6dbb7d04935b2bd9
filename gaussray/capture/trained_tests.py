"""Pictures to score that are training pictures, too: their scores tell nothing."""

import filecmp
import warnings
from pathlib import Path

import numpy as np

from gaussray.capture.capture import Capture, View
from gaussray.capture.errors import CaptureWarning


_Facts = tuple[float, ...]


def warn_of_trained_tests(capture: Capture) -> None:
    """Warn of pictures to score that are training pictures, or copies of their files with the same
    time and pose.

    Args:
        capture: the capture as selected.
    """
    trained = [view for view in capture.views if view.split == "train"]
    held = [view for view in capture.views if view.split == "test"]
    scored = [view for views in (held, *capture.effects.values()) for view in views]
    images, alike = {view.image for view in trained}, dict[_Facts, list[Path]]()
    for view in trained if scored else ():
        alike.setdefault(_facts(view), []).append(view.image)
    both = [v for v in scored if v.image in images or _is_copy(v.image, alike.get(_facts(v), []))]
    if both:
        warnings.warn(
            f"{capture.folder}: {len(both)} pictures to score, first {both[0].image.name}, are "
            "training pictures, too, or copies of them, so that their scores tell nothing. Hold "
            "others out: capture.test, or the key split of frames.",
            CaptureWarning,
            stacklevel=3,
        )


def _facts(view: View) -> _Facts:
    """Time and pose of a view."""
    path = view.camera.trajectory
    return view.time, *np.asarray(path.translation)[0].tolist(), *np.asarray(path.quat)[0].tolist()


def _is_copy(image: Path, others: list[Path]) -> bool:
    """Whether a file has the bytes of another one. Pictures in videos are no files."""
    return image.is_file() and any(
        other.is_file() and filecmp.cmp(image, other, shallow=False) for other in others
    )
