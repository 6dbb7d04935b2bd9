"""The scores of one picture, and its line in scores.jsonl."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, UInt8

from gaussray.capture.capture import View
from gaussray.dataset.images import srgb_levels
from gaussray.evaluate.masks import MotionMasks, circle_mask, view_levels, visible_mask
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
        visible: the pixels inside the lens's field of view; None: all.
    """

    row: dict[str, Any]
    real: UInt8[np.ndarray, "h w 3"]
    ours: UInt8[np.ndarray, "h w 3"]
    visible: Bool[np.ndarray, "h w"] | None


def score_picture(
    view: View,
    frame: Frame,
    masks: MotionMasks,
    *,
    perceptual: Mapping[str, Metric],
    trained: set[str],
) -> ScoredPicture:
    """Score a rendering against the picture of its view.

    Args:
        view: the recorded camera and its picture.
        frame: the rendering.
        masks: tells which pixels move.
        perceptual: the metrics beside PSNR and SSIM, by name (`perceptual_metrics`).
        trained: names of the cameras that the scene was fitted to.
    """
    ours, real = srgb_levels(frame.color), view_levels(view)
    visible = visible_mask(view.camera)
    fills = view.camera.lens.fills_picture
    row = _scores(real, ours, visible, masks.moving(view, real), fills=fills)
    row |= {name: measure(real, ours) for name, measure in perceptual.items()}
    row["seconds"] = None if frame.compiled else frame.seconds
    row["part"] = _part(view, trained)
    return ScoredPicture(row, real, ours, visible)


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


def _scores(
    real: UInt8[np.ndarray, "h w 3"],
    ours: UInt8[np.ndarray, "h w 3"],
    visible: Bool[np.ndarray, "h w"] | None,
    moving: Bool[np.ndarray, "h w"] | None,
    *,
    fills: bool,
) -> dict[str, Any]:
    """PSNR, SSIM and what moves (`ScoredPicture.row`).

    Where a lens should fill the picture (`fills`), pixels without a ray do not count, nor a rim of
    one pixel around these: the scene cannot show there what the picture does. Around the circle of
    a fisheye both are black. SSIM leaves out the border of the picture, whatever else counts.
    """
    counted = visible if fills else None
    score: dict[str, Any] = {"psnr": psnr(real, ours, counted)}
    score["ssim"] = ssim(real, ours, counted)
    if moving is not None and counted is not None:
        moving = moving & counted
    if visible is not None:
        for name, mask in (("masked", visible), ("circle", circle_mask(visible.shape))):
            score[f"psnr_{name}"] = psnr(real, ours, mask)
            score[f"ssim_{name}"] = ssim(real, ours, mask)
    if moving is not None and moving.any():
        error = (real.astype(np.float64) - ours)[moving] / 255
        score["moving"] = (float(np.sum(error**2)), error.size)
    return score


def _part(view: View, trained: set[str]) -> str:
    if view.split == "train":
        return "train"
    return "held_out_times" if view.camera_name in trained else "held_out_cameras"
