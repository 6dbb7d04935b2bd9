"""Pictures to score that are training pictures, too: their scores tell nothing."""

import filecmp
import warnings

import numpy as np

from gaussray.capture.capture import Capture, View
from gaussray.capture.errors import CaptureWarning


def warn_of_trained_tests(capture: Capture) -> None:
    """Warn of pictures to score that are training pictures, or copies of their files with the same
    time and pose.

    Args:
        capture: the capture as selected.
    """
    trained = [view for view in capture.views if view.split == "train"]
    held = [view for view in capture.views if view.split == "test"]
    scored = [view for views in (held, *capture.effects.values()) for view in views]
    images, alike = {view.image for view in trained}, dict[tuple[float, int], list[View]]()
    for view in trained if scored else ():
        alike.setdefault(_time_and_bytes(view), []).append(view)
    both = [
        view
        for view in scored
        if view.image in images
        or any(_is_copy(view, other) for other in alike.get(_time_and_bytes(view), ()))
    ]
    if both:
        warnings.warn(
            f"{capture.folder}: {len(both)} pictures to score, first {both[0].image.name}, are "
            "training pictures, too, or copies of them, so that their scores tell nothing. Hold "
            "others out: capture.test, or the key split of frames.",
            CaptureWarning,
            stacklevel=3,
        )


def _time_and_bytes(view: View) -> tuple[float, int]:
    """Time and size of the file of a view; pictures in videos are no files, and have -1."""
    return view.time, view.image.stat().st_size if view.image.is_file() else -1


def _is_copy(view: View, other: View) -> bool:
    """Whether two views of one time have one pose, and files of the same bytes."""
    own, known = view.camera.trajectory, other.camera.trajectory
    return (
        view.image.is_file()
        and np.array_equal(own.translation, known.translation)
        and np.array_equal(own.quat, known.quat)
        and filecmp.cmp(view.image, other.image, shallow=False)
    )
