"""Mean scores of many pictures, and a report as a text table."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gaussray.color import psnr_from_mse
from gaussray.evaluate.flicker import Flicker


# Heading, key of the report, decimal places.
COLUMNS = (
    ("PSNR", "psnr", 2),
    ("SSIM", "ssim", 3),
    ("masked PSNR", "psnr_masked", 2),
    ("masked SSIM", "ssim_masked", 3),
    ("moving PSNR", "psnr_moving", 2),
    ("exposure-matched PSNR", "psnr_matched", 2),
    ("opacity outside masks", "opacity_outside_masks", 3),
    ("flicker", "flicker", 2),
    ("truth's", "flicker_truth", 2),
    ("FLIP", "flip", 3),
    ("LPIPS", "lpips", 3),
    ("FPS", "fps", 1),
    ("frames", "frames", 0),
)
OPTIONAL = (
    *("psnr_matched", "opacity_outside_masks"),
    *("flicker", "flicker_truth", "flip", "lpips"),
)
MEANS = (
    *("psnr", "ssim", "psnr_masked", "ssim_masked", "psnr_circle", "ssim_circle"),
    *("psnr_matched", "opacity_outside_masks", "shown_share", "flip", "lpips"),
)
# Stops (rms) by which pictures must be lighter or darker than their renderings to have
# exposure-matched scores.
_STOPS, _EXPOSURE = 0.1, ("psnr_matched", "exposure_stops")


def summary(
    rows: Sequence[dict[str, Any]], samples: int, flicker: Flicker | None = None
) -> dict[str, Any]:
    """Mean scores of an effect.

    Args:
        rows: scores of each picture, with its `part` (training, held-out cameras or times).
        samples: rays per pixel.
        flicker: flicker of the effect's cameras.

    Returns:
        Means over the pictures, PSNR of moving pixels from their pooled mean squared error,
        flicker, and under `parts` the same for each part, if there are several. `psnr_matched`
        and `exposure_stops` (root mean square) are given where exposures differ.
    """
    if _stops(rows) <= _STOPS:
        rows = [{k: x for k, x in row.items() if k not in _EXPOSURE} for row in rows]
    names = sorted({row["part"] for row in rows})
    flicker = flicker or Flicker()
    parts = {
        name: _means([row for row in rows if row["part"] == name], samples) | flicker.figures(name)
        for name in names
    }
    total = _means(rows, samples) | flicker.figures()
    return total | ({"parts": parts} if len(parts) > 1 else {})


def scores_text(report: dict[str, Any]) -> str:
    """The effects of a report as a text table, with their parts below them; flicker, FLIP and LPIPS
    only if measured; then its remarks, a line each."""
    rows = []
    for name, row in report["effects"].items():
        rows.append((name, row))
        rows += [
            ("  " + part.replace("_", " "), part_row)
            for part, part_row in row.get("parts", {}).items()
        ]
    measured = {key for _, row in rows for key in row}
    columns = [c for c in COLUMNS if c[1] in measured or c[1] not in OPTIONAL]
    lines = [("effect", [head for head, _, _ in columns])]
    lines += [(n, [score_text(row, key, digits) for _, key, digits in columns]) for n, row in rows]
    widths = [max(len(head) + 2, 8) for head, _, _ in columns]
    table = [
        f"{name:<20}" + "".join(f"{v:>{w}}" for v, w in zip(values, widths, strict=True))
        for name, values in lines
    ]
    return "\n".join([*table, *report.get("remarks", [])])


def _stops(rows: Sequence[Mapping[str, Any]]) -> float:
    """Root mean square of how much lighter pictures are than their renderings, in stops."""
    stops = [row["exposure_stops"] for row in rows if "exposure_stops" in row]
    return float(np.sqrt(np.mean(np.square(stops)))) if stops else 0.0


def _means(rows: Sequence[dict[str, Any]], samples: int) -> dict[str, Any]:
    means: dict[str, Any] = {}
    for name in MEANS:
        # A picture that its mask hides has no score.
        values = [row[name] for row in rows if name in row]
        if values:
            mean = float(np.mean(values))
            # Equal pictures have an infinite PSNR, which JSON cannot represent: it is null, and
            # what is not measured is left out.
            means[name] = round(mean, 4) if np.isfinite(mean) else None
    if "psnr_matched" in means:
        means["exposure_stops"] = round(_stops(rows), 4)
    error = [row["moving"] for row in rows if "moving" in row]
    if error:
        mse = sum(e for e, _ in error) / sum(n for _, n in error)
        means["psnr_moving"] = round(psnr_from_mse(mse), 4) if mse else None
    seconds = [row["seconds"] for row in rows if row["seconds"] is not None]
    means["fps"] = round(1 / float(np.median(seconds)), 2) if seconds else None
    return means | {"samples": samples, "frames": len(rows)}


def score_text(row: Mapping[str, Any], key: str, digits: int) -> str:
    """A score of a report with so many digits: "inf" for the PSNR of equal pictures, which a report
    stores as null, and "-" for what was not measured.

    Args:
        row: the scores of an effect, or of a part of it.
        key: name of the score.
        digits: digits after the point.
    """
    value = row.get(key)
    if value is None:
        return "inf" if key in row and key.startswith("psnr") else "-"
    return f"{value:.{digits}f}"
