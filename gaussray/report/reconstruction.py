"""Sections of a reconstruction report: training curves and pruning."""

from pathlib import Path
from typing import Any

import numpy as np

from gaussray.report.chart import Curve, chart
from gaussray.report.markup import Markup, tag
from gaussray.report.page import Section, html_table, note
from gaussray.report.run import duration, json_document, json_lines


# Keys of metrics.jsonl that are not terms of the loss.
_OTHER = ("segment", "stage", "step", "seconds", "psnr", "gaussians", "mse")
# Names of the terms of the loss.
TERMS = {
    "l1": "L1",
    "dssim": "1 - SSIM",
    "backdrop_opacity": "opacity before the plain backdrop",
    "rigid": "control points: neighbours that move apart",
    "time_planes_from_one": "planes: distance from 1",
    "plane_variation": "planes: smoothness in space",
    "time_smoothness": "planes: smoothness in time",
    "opacity_cost": "mean opacity (transient times density.transient_cost)",
    "scale_cost": "mean scale (transient times density.transient_cost)",
}


def training_curves(out: Path) -> Section | None:
    """PSNR, loss terms, number of Gaussians and time per step over all training steps."""
    log = json_lines(out / "metrics.jsonl")
    if not log:
        return None
    step, borders = step_numbers(log)
    psnr = Curve("tiles drawn", step, _column(log, "psnr"))
    names = [name for line in log for name in line if name not in _OTHER]
    terms = [Curve(TERMS.get(n, n), step, _column(log, n)) for n in dict.fromkeys(names)]
    pace, at = milliseconds_per_step(log, step)
    count = Curve("Gaussians", step, _column(log, "gaussians"))
    changes = np.ptp(count.y[np.isfinite(count.y)]) if np.isfinite(count.y).any() else 0
    drawn = [
        chart("PSNR of the tiles drawn (dB)", [psnr], x_label="step", borders=borders),
        chart("loss terms", terms, x_label="step", log=True, borders=borders),
        chart("milliseconds per step", [Curve("ms", at, pace)], x_label="step", borders=borders),
        chart("Gaussians", [count], x_label="step", borders=borders) if changes else None,
    ]
    words = "Each point is the mean over a block of steps. Tiles are drawn more often where the "
    words += "scene is worse, so their PSNR is below that of all training rays. The time per step "
    words += "leaves out blocks in which programs were compiled."
    return Section("Training", [tag("div", drawn, class_="grid"), note(words)])


def stage_durations(out: Path) -> list[tuple[str, str]]:
    """Duration of each training stage, from its first log line to its last."""
    durations: dict[str, list[float]] = {}
    for line in json_lines(out / "metrics.jsonl"):
        durations.setdefault(_stage(line), []).append(line["seconds"])
    return [(name, duration(max(x[-1] - x[0], 0.0))) for name, x in durations.items() if len(x) > 1]


def training_psnr(out: Path) -> float | None:
    """PSNR of training rays in dB: of those that were drawn evenly of all pictures after the fit,
    the mean of all segments; before that, of the last block of steps, whose rays are drawn where
    errors are large. None without a log."""
    report, log = json_document(out / "requirement.json"), json_lines(out / "metrics.jsonl")
    parts = [part.get("after", part) for part in report.get("segments", [report])]
    measured = [part["psnr"] for part in parts if part.get("psnr") is not None]
    if measured:
        return sum(measured) / len(measured)
    return log[-1]["psnr"] if log else None


def pruning(report: dict[str, Any]) -> Section | None:
    """What pruning removed from the scene, what it kept, and the PSNR that each removal costs."""
    body: list[Markup] = []
    for i, segment in enumerate(report.get("segments", [report]), 1):
        if "steps" not in segment:
            continue
        several = len(report.get("segments", [])) > 1
        body += [tag("h3", f"segment {i}")] if several else []
        before, after = segment["before"], segment["after"]
        body.append(html_table(
            ("", "before", "after"),
            [(_WORDS.get(name, name), _figure(x), _figure(after.get(name)))
             for name, x in before.items()],
        ))  # fmt: skip
        body.append(html_table(
            ("candidate", "removed", "PSNR loss (dB)"),
            [(s["step"], "yes" if s["taken"] else "no", f"{s['loss']:.4f}")
             for s in segment["steps"]],
        ))  # fmt: skip
    words = "A candidate is removed if the PSNR of training rays falls by at most prune.loss dB."
    return Section("Pruning", [*body, note(words)]) if body else None


_WORDS = {
    "gaussians": "Gaussians",
    "moving": "moving Gaussians",
    "heads": "heads of the deformation network",
    "scales": "scales of the feature planes",
    "rows": "rows of the planes in time",
    "shades": "times of passing shadows",
    "degree": "degree of the spherical harmonics",
    "bytes": "bytes in memory",
    "psnr": "PSNR (dB)",
}


def _figure(value: Any) -> str:
    return f"{value:,}" if isinstance(value, int) else f"{value:.2f}" if value is not None else "-"


def _stage(line: dict[str, Any]) -> str:
    part = f"{line['segment']}: " if "segment" in line else ""
    return f"{part}{line['stage']}"


def step_numbers(log: list[dict[str, Any]]) -> tuple[np.ndarray, list[tuple[float, str]]]:
    """Step numbers counted through all stages, and the (step, name) at which each stage begins."""
    steps, borders, before, last, stage = [], [], 0, 0, None
    for line in log:
        if _stage(line) != stage:
            before, stage = before + last, _stage(line)
            borders.append((float(before), stage))
        last = line["step"]
        steps.append(before + last)
    return np.array(steps, float), borders


def _column(log: list[dict[str, Any]], name: str) -> np.ndarray:
    values = [line.get(name) for line in log]
    return np.array([np.nan if value is None else value for value in values], float)


def milliseconds_per_step(
    log: list[dict[str, Any]], step: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Milliseconds per step between consecutive log lines of a stage, and their steps.

    Args:
        log: lines of metrics.jsonl.
        step: number of the step of each line (`step_numbers`).
    """
    seconds = _column(log, "seconds")
    same = np.array([_stage(a) == _stage(b) for a, b in zip(log, log[1:], strict=False)], bool)
    spent, done = np.diff(seconds), np.diff(step)
    valid = same & (spent > 0) & (done > 0)
    pace = 1e3 * spent[valid] / done[valid]
    median = np.median(pace) if len(pace) else 0.0
    regular = pace < 8 * median
    return pace[regular], step[1:][valid][regular]
