"""How an evaluation came out: a table of effects, curves over time, pictures beside the truth."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gaussray.capture.frames import read_stored
from gaussray.evaluate.pipeline import SCORES
from gaussray.evaluate.scores import COLUMNS
from gaussray.report.chart import Curve, chart
from gaussray.report.markup import Markup, tag
from gaussray.report.page import Section, note, table
from gaussray.report.picture import BYTES, compared, heat_scale
from gaussray.report.run import lines


PARTS = {
    "train": "training views",
    "held_out_cameras": "held-out cameras",
    "held_out_times": "held-out times",
}
# Cameras whose curves are told apart in one chart.
CURVES = 8


def scores(report: dict[str, Any]) -> Section | None:
    """A row for each effect, and for each of its parts."""
    rows = []
    shown = ({"training views": report["train"]} if "train" in report else {}) | report["effects"]
    for name, row in shown.items():
        rows.append((name.replace("_", " "), row))
        rows += [(tag("span", PARTS.get(part, part), class_="part"), own)
                 for part, own in row.get("parts", {}).items()]  # fmt: skip
    if not rows:
        return None
    measured = {key for _, row in rows for key in row}
    columns = [c for c in COLUMNS if c[1] in measured]
    columns = [*columns, ("rays per pixel", "samples", 0)]
    body = [[name, *(_figure(row.get(key), n) for _, key, n in columns)] for name, row in rows]
    words = (
        "PSNR in dB of 8-bit sRGB codes, mean over the pictures. Masked: inside the lens's field "
    )
    words += "of view. Moving: over pixels that change. Flicker: how much pixels that never move "
    words += "tremble, in codes of 255, and the truth's own. FPS without compilation."
    return Section("Scores", [table(["effect", *(c[0] for c in columns)], body), note(words)])


def over_time(out: Path) -> Section | None:
    """PSNR of every picture, a chart for each effect."""
    told, drawn = lines(out / SCORES), []
    for effect in dict.fromkeys(line["effect"] for line in told):
        own = [line for line in told if line["effect"] == effect]
        cameras = list(dict.fromkeys(line["camera"] for line in own))
        if len(own) < 3:
            continue
        some = [Curve(name, *_series([x for x in own if x["camera"] == name]))
                for name in cameras[:CURVES]]  # fmt: skip
        drawn.append(chart(f"{effect.replace('_', ' ')}: PSNR (dB)", some, x_label="time"))
    return Section("Every picture", [tag("div", drawn, class_="grid")]) if drawn else None


def pictures(out: Path) -> Section | None:
    """Of every effect the worst and the middle picture beside the truth."""
    told = [line for line in lines(out / SCORES) if (out / line["file"]).is_file()]
    effects = list(dict.fromkeys(line["effect"] for line in told))
    if not effects:
        return None
    picked = {effect: _picked([x for x in told if x["effect"] == effect]) for effect in effects}
    most = BYTES // (3 * sum(map(len, picked.values())))
    body: list[Any] = [heat_scale()]
    for effect, chosen in picked.items():
        figures = [_compared(out, line, word, most) for word, line in chosen]
        body += [tag("h3", effect.replace("_", " ")), tag("div", figures, class_="grid pairs")]
    return Section("Truth and ours", body)


def _picked(told: Sequence[dict[str, Any]]) -> list[tuple[str, dict[str, Any]]]:
    ranked = sorted(told, key=lambda line: np.inf if line["psnr"] is None else line["psnr"])
    named = {0: "worst", len(ranked) // 2: "median"} if len(ranked) > 1 else {0: "the only one"}
    return [(word, ranked[i]) for i, word in named.items()]


def _compared(out: Path, line: dict[str, Any], word: str, most: int) -> Markup:
    stored = _codes(out / line["file"])
    width = stored.shape[1] // 3
    psnr = "equal" if line["psnr"] is None else f"{line['psnr']:.2f} dB"
    caption = [tag("b", f"{word}: {psnr}"), f" · {line['camera']}, time {line['time']:.4g}"]
    return compared(stored[:, :width], stored[:, width : 2 * width], caption, most=most)


def _codes(path: Path) -> np.ndarray:
    """Truth, ours and their difference, as they are stored side by side."""
    from gaussray.io.safe.openimageio import oiio

    spec = oiio.ImageBuf(str(path)).spec()
    return read_stored(path, spec.width, spec.height)


def _series(told: Sequence[dict[str, Any]]) -> tuple[np.ndarray, np.ndarray]:
    ranked = sorted(told, key=lambda line: line["time"])
    psnr = [np.nan if line["psnr"] is None else line["psnr"] for line in ranked]
    return np.array([line["time"] for line in ranked]), np.array(psnr, float)


def _figure(value: float | int | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
