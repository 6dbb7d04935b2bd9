"""Tells a fit that failed, or must fail, from one that is merely coarse; names the likely cause."""

import warnings
from typing import Any

import numpy as np

from gaussray.capture.capture import Capture
from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.dataset.manifest import rotation_and_position
from gaussray.reconstruct.data.pictures import Footage
from gaussray.reconstruct.data.segments import training_views
from gaussray.runtime.errors import FitError
from gaussray.scene.scene import Scene


# Cameras that differ by less, relative to their distance from the origin, stand in one place.
_SAME_PLACE = 1e-5


class FailedFit(FitError):
    """A fit ended below what one colour per camera scores, or with an empty scene."""


def demand_detail(footage: Footage) -> None:
    """Refuse pictures in which there is nothing to see.

    Raises:
        CaptureError: Every picture shows a single colour.
    """
    count = len(footage.pixel)
    if any(_has_detail(footage, frame) for frame in range(count)):
        return
    which = (
        "the only training picture shows"
        if count == 1
        else f"each of the {count} training pictures shows"
    )
    raise CaptureError(
        f"{which} a single colour, so there is nothing to reconstruct. Look at the pictures, "
        "their masks (white pixels count) and capture.crop."
    )


def _has_detail(footage: Footage, frame: int) -> bool:
    """Whether a picture shows more than one colour."""
    pixel, visible = footage.pixel[frame], footage.visible(frame)
    shown = pixel.reshape(-1, 3) if visible is None else pixel[visible]
    return bool((shown != shown[:1]).any())


def warn_of_one_place(capture: Capture) -> None:
    """Warn if all training pictures are taken from one place, and no points tell distances."""
    views = training_views(capture)
    if capture.points is not None or not views:
        return
    first = rotation_and_position(views[0].camera)[1]
    limit = _SAME_PLACE * max(1.0, float(np.abs(first).max()))
    for view in views[1:]:
        if np.abs(rotation_and_position(view.camera)[1] - first).max() > limit:
            return
    what = "there is one training picture"
    if len(views) > 1:
        what = "all training pictures are taken from one place"
    warnings.warn(
        f"{what}, and there are no points: nothing tells how far away things are. Pictures from "
        "other places will be wrong. Add pictures from other places, or points.",
        CaptureWarning,
        stacklevel=2,
    )


def demand_success(scene: Scene, report: dict[str, Any], capture: Capture, start: str) -> None:
    """Refuse the scene of a failed fit, before it is written.

    Args:
        scene: the scene after pruning.
        report: the report of pruning; `psnr` and `one_color` are the PSNR of the fit and that of
            the mean colour of every camera, in dB, on the same training pixels.
        capture: the capture, in which the cause is looked for.
        start: fit.start, which points the fit began with.

    Raises:
        FailedFit: The fit scores less than one colour per camera, or no Gaussian is left.
    """
    psnr, one_color = report["psnr"], report["one_color"]
    if psnr < one_color:
        fact = (
            f"the fit failed: {psnr:.1f} dB on the training pictures, where one colour per camera "
            f"has {one_color:.1f} dB"
        )
    elif not scene.count:
        fact = "the fit failed: the training pictures need none of its Gaussians"
    else:
        return
    raise FailedFit(
        f"{fact}. No scene is written. Likely causes: {'; '.join(_causes(capture, start))}."
    )


def _causes(capture: Capture, start: str) -> list[str]:
    """What commonly makes a fit fail, as far as the capture allows for it, likeliest first."""
    causes = []
    if start == "random" or (start == "given" and capture.points is None):
        causes.append(
            "the fit began with random points (fit.start=auto takes those of the capture or of its "
            "pictures)"
        )
    elif capture.points is None:
        causes.append(
            "the capture has no points, and stereo found few or wrong ones in its pictures (blur, "
            "cameras far apart or not in step; add points, e.g. from COLMAP)"
        )
    causes.append(
        "the background (capture.background says what transparent pixels show, and masks which "
        "pixels count)"
    )
    causes.append("poses in another convention or of other pictures")
    causes.append("too few steps (fit.coarse, fit.fine)")
    return causes
