"""Sections of an evaluation report: scores per effect, PSNR over time, pictures beside truth."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gaussray.capture.picture_file import read_stored
from gaussray.evaluate.pipeline import SCORES
from gaussray.evaluate.scores import COLUMNS, score_text
from gaussray.report.chart import Curve, chart
from gaussray.report.markup import Markup, tag
from gaussray.report.page import Section, html_table, note
from gaussray.report.picture import BYTES, comparison_figure, error_scale
from gaussray.report.run import json_lines


SPLIT_NAMES = {
    "train": "training views",
    "held_out_cameras": "held-out cameras",
    "held_out_times": "held-out times",
}
# Cameras per chart, at most.
MAX_CURVES = 8


def score_table(report: dict[str, Any]) -> Section | None:
    """A row for each effect and for each of its parts (training, held out)."""
    rows = []
    scores = ({"training views": report["train"]} if "train" in report else {}) | report["effects"]
    for name, row in scores.items():
        rows.append((name.replace("_", " "), row))
        rows += [(tag("span", SPLIT_NAMES.get(part, part), class_="part"), part_row)
                 for part, part_row in row.get("parts", {}).items()]  # fmt: skip
    if not rows:
        return None
    measured = {key for _, row in rows for key in row}
    columns = [c for c in COLUMNS if c[1] in measured]
    columns = [*columns, ("rays per pixel", "samples", 0)]
    body = [[name, *(score_text(row, key, n) for _, key, n in columns)] for name, row in rows]
    words = (
        "PSNR in dB between 8-bit sRGB pictures, mean over the pictures; what their masks hide "
        "counts in no score. Masked: over pixels that masks show, inside the lens's field of view. "
        "Moving: over pixels that change in time. Exposure-matched: after the best gain of each "
        "picture and channel. Opacity outside masks: of the rendering where masks hide the "
        "picture, 0 to 1, lower is better. Flicker: standard deviation over time of pixels that "
        "never move, in 8-bit levels (0-255), beside that of the capture. FPS: rendered frames per "
        "second without compilation."
    )
    table = html_table(["effect", *(c[0] for c in columns)], body)
    return Section("Scores", [table, *map(note, report.get("remarks", [])), note(words)])


def psnr_over_time(out: Path) -> Section | None:
    """PSNR of every picture over time, a chart for each effect."""
    scores, charts = _lines_with_scores(out), []
    for effect in dict.fromkeys(line["effect"] for line in scores):
        views = [line for line in scores if line["effect"] == effect]
        cameras = list(dict.fromkeys(line["camera"] for line in views))
        if len(views) < 3:
            continue
        curves = [Curve(name, *_series([x for x in views if x["camera"] == name]))
                for name in cameras[:MAX_CURVES]]  # fmt: skip
        charts.append(chart(f"{effect.replace('_', ' ')}: PSNR (dB)", curves, x_label="time"))
    return Section("PSNR over time", [tag("div", charts, class_="grid")]) if charts else None


def compared_pictures(out: Path) -> Section | None:
    """For each effect the pictures of worst and median PSNR beside the truth."""
    scores = [line for line in _lines_with_scores(out) if (out / line["file"]).is_file()]
    effects = list(dict.fromkeys(line["effect"] for line in scores))
    if not effects:
        return None
    picked = {
        effect: _worst_and_median([x for x in scores if x["effect"] == effect])
        for effect in effects
    }
    most = BYTES // (3 * sum(map(len, picked.values())))
    body: list[Any] = [error_scale()]
    for effect, chosen in picked.items():
        figures = [_comparison(out, line, word, most) for word, line in chosen]
        body += [tag("h3", effect.replace("_", " ")), tag("div", figures, class_="grid pairs")]
    return Section("Capture and rendering", body)


def _lines_with_scores(out: Path) -> list[dict[str, Any]]:
    """The lines of all pictures but those that their masks hide."""
    return [line for line in json_lines(out / SCORES) if "psnr" in line]


def _worst_and_median(scores: Sequence[dict[str, Any]]) -> list[tuple[str, dict[str, Any]]]:
    ranked = sorted(scores, key=lambda line: np.inf if line["psnr"] is None else line["psnr"])
    named = {0: "worst", len(ranked) // 2: "median"} if len(ranked) > 1 else {0: "only picture"}
    return [(word, ranked[i]) for i, word in named.items()]


def _comparison(out: Path, line: dict[str, Any], word: str, most: int) -> Markup:
    stored = _stored_levels(out / line["file"])
    width = stored.shape[1] // 3
    psnr = "equal" if line["psnr"] is None else f"{line['psnr']:.2f} dB"
    caption = [tag("b", f"{word}: {psnr}"), f" · {line['camera']}, time {line['time']:.4g}"]
    truth, ours, difference = (stored[:, k * width : (k + 1) * width] for k in range(3))
    # The stored difference is 0 where a mask hides the picture, too.
    return comparison_figure(truth, ours, caption, shown=difference.max(axis=2) > 0, most=most)


def _stored_levels(path: Path) -> np.ndarray:
    """The stored picture: truth, rendering and difference side by side, 8-bit sRGB."""
    from gaussray.io.safe.openimageio import oiio

    spec = oiio.ImageBuf(str(path)).spec()
    return read_stored(path, spec.width, spec.height)


def _series(scores: Sequence[dict[str, Any]]) -> tuple[np.ndarray, np.ndarray]:
    ranked = sorted(scores, key=lambda line: line["time"])
    psnr = [np.nan if line["psnr"] is None else line["psnr"] for line in ranked]
    return np.array([line["time"] for line in ranked]), np.array(psnr, float)
