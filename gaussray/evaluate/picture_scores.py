"""The scores of one picture, and its line in scores.jsonl."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, UInt8

from gaussray.capture.capture import View
from gaussray.evaluate.exposure import exposure_match, recorded_levels
from gaussray.evaluate.found_cameras import FoundCapture
from gaussray.evaluate.masks import (
    MotionMasks,
    circle_mask,
    levels_and_mask,
    visible_mask,
)
from gaussray.evaluate.metrics import psnr, ssim
from gaussray.evaluate.perceptual import Metric
from gaussray.render.frame import Frame


class ScoredPicture(NamedTuple):
    """A picture and its scores.

    Args:
        row: the scores by name; `seconds` that rendering took, None where it also compiled; and
            `part`: train, held_out_times or held_out_cameras. `moving` is no score but what the
            PSNR of the moving pixels of many pictures is made of: the sum of their squared errors
            and the number of their values. It is absent where nothing is known to move.
        real: the truth, in 8-bit levels.
        ours: the rendering, in 8-bit levels.
        shown: the pixels that the mask of the view lets count; None: all.
        visible: those of them inside the lens's field of view; None: all.
    """

    row: dict[str, Any]
    real: UInt8[np.ndarray, "h w 3"]
    ours: UInt8[np.ndarray, "h w 3"]
    shown: Bool[np.ndarray, "h w"] | None
    visible: Bool[np.ndarray, "h w"] | None


def score_picture(
    view: View,
    frame: Frame,
    masks: MotionMasks,
    *,
    perceptual: Mapping[str, Metric],
    found: FoundCapture,
    silhouettes: bool = False,
) -> ScoredPicture:
    """Score a rendering, as the camera records it, against the picture of its view.

    Args:
        view: the recorded camera and its picture.
        frame: the rendering.
        masks: tells which pixels move.
        perceptual: the metrics beside PSNR and SSIM, by name (`perceptual_metrics`).
        found: the capture, and what the fit found for its cameras.
        silhouettes: whether masks cut an object out: then opacity where they hide is a score.
    """
    real, shown = levels_and_mask(view)
    ours = recorded_levels(frame.color, found.response(view))
    sees = visible_mask(view.camera)
    # What is hidden is black in both pictures: else its error would spread to what is shown.
    truth, image = (x if shown is None else x * shown[..., None] for x in (real, ours))
    counted = _counted(view, sees, shown)
    row = _scores(truth, image, masks.moving(view, real), counted)
    match = exposure_match(truth, image, counted[""])
    row |= {"psnr_matched": match.psnr, "exposure_stops": match.stops}
    if shown is not None:
        row["shown_share"] = float(shown.mean())
    hidden = None if shown is None or not silhouettes else _both(~shown, sees)
    if hidden is not None and hidden.any():
        row["opacity_outside_masks"] = float(np.mean(frame.alpha[hidden], dtype=np.float64))
    row |= _perceived(perceptual, truth, image, shown)
    # What a mask hides as a whole has no score.
    row = {name: x for name, x in row.items() if not (isinstance(x, float) and np.isnan(x))}
    row["seconds"] = None if frame.compiled else frame.seconds
    row["part"] = found.part(view)
    return ScoredPicture(row, real, ours, shown, _both(sees, shown))


def score_line(effect: str, view: View, row: Mapping[str, Any]) -> dict[str, Any]:
    """The line of a picture in scores.jsonl; `file` is its truth | rendering | difference.

    Args:
        effect: the effect that the picture shows.
        view: its view.
        row: its scores (`ScoredPicture.row`).
    """
    named = {"effect": effect, "camera": view.camera_name, "time": view.time, "part": row["part"]}
    file = f"{effect}/{picture_file_name(view)}"
    figures = {name: x for name, x in row.items() if isinstance(x, float)}
    # Equal pictures have an infinite PSNR, which JSON cannot represent.
    figures = {name: x if np.isfinite(x) else None for name, x in figures.items()}
    return named | {"file": file} | figures


def picture_file_name(view: View) -> str:
    """The file of a picture, in the folder of its effect."""
    return f"{view.camera_name}_{view.time:.4f}.png"


def _counted(
    view: View, sees: Bool[np.ndarray, "h w"] | None, shown: Bool[np.ndarray, "h w"] | None
) -> dict[str, Bool[np.ndarray, "h w"] | None]:
    """The pixels over which each kind of score is a mean, by the end of its name; None: all.

    What the mask of the view hides never counts. Where a lens should fill the picture, neither do
    pixels without a ray, nor a rim of one pixel around these: the scene cannot show there what the
    picture does. Around the circle of a fisheye both are black. `_masked` is given where a mask or
    the lens hides a part.
    """
    both = _both(sees, shown)
    if sees is None:
        return {"": both} if shown is None else {"": both, "_masked": both}
    whole = both if view.camera.lens.fills_picture else shown
    return {"": whole, "_masked": both, "_circle": _both(circle_mask(sees.shape), shown)}


def _both(
    one: Bool[np.ndarray, "h w"] | None, other: Bool[np.ndarray, "h w"] | None
) -> Bool[np.ndarray, "h w"] | None:
    """The pixels of two masks, of which None is all."""
    return other if one is None else one if other is None else one & other


def _scores(
    real: UInt8[np.ndarray, "h w 3"],
    ours: UInt8[np.ndarray, "h w 3"],
    moving: Bool[np.ndarray, "h w"] | None,
    counted: Mapping[str, Bool[np.ndarray, "h w"] | None],
) -> dict[str, Any]:
    """PSNR, SSIM and what moves (`ScoredPicture.row`). SSIM leaves out the border of the picture,
    whatever else counts."""
    score: dict[str, Any] = {}
    for name, mask in counted.items():
        same = name and mask is counted[""]
        score[f"psnr{name}"] = score["psnr"] if same else psnr(real, ours, mask)
        score[f"ssim{name}"] = score["ssim"] if same else ssim(real, ours, mask)
    moving = None if moving is None else _both(moving, counted[""])
    if moving is not None and moving.any():
        error = (real.astype(np.float64) - ours)[moving] / 255
        score["moving"] = (float(np.sum(error**2)), error.size)
    return score


def _perceived(
    metrics: Mapping[str, Metric],
    real: UInt8[np.ndarray, "h w 3"],
    ours: UInt8[np.ndarray, "h w 3"],
    shown: Bool[np.ndarray, "h w"] | None,
) -> dict[str, float]:
    """The perceptual scores over what is shown."""
    if shown is not None and not shown.any():
        return {}
    return {name: measure(real, ours, shown) for name, measure in metrics.items()}
