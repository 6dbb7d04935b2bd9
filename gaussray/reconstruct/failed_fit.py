"""Tells a fit that failed from one that is merely coarse, and names the likely cause."""

from typing import Any

from gaussray.capture.capture import Capture
from gaussray.scene.scene import Scene


class FailedFit(RuntimeError):
    """A fit ended below what one colour per camera scores, or with an empty scene."""


def demand_success(scene: Scene, report: dict[str, Any], capture: Capture, start: str) -> None:
    """Refuse the scene of a failed fit, before it is written.

    Args:
        scene: The scene after pruning.
        report: The report of pruning; `psnr` and `one_color` are the PSNR of the fit and that of
            the mean colour of every camera, in dB, on the same training pixels.
        capture: The capture, in which the cause is looked for.
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
