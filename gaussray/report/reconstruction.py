"""How a reconstruction went: curves of the fit, what the scene requires."""

from pathlib import Path
from typing import Any

import numpy as np

from gaussray.report.chart import Curve, chart
from gaussray.report.markup import Markup, tag
from gaussray.report.page import Section, note, table
from gaussray.report.run import clock, lines


# What a line of metrics.jsonl holds beside terms of the loss.
_OTHER = ("segment", "stage", "step", "seconds", "psnr", "gaussians", "mse")
# How terms of the loss are called.
TERMS = {
    "l1": "difference (L1)",
    "ssim": "structure (SSIM)",
    "one": "planes near 1",
    "space": "planes smooth in space",
    "time": "planes smooth in time",
}


def curves(out: Path) -> Section | None:
    """PSNR, terms of the loss, Gaussians and pace over all steps."""
    told = lines(out / "metrics.jsonl")
    if not told:
        return None
    step, borders = _steps(told)
    psnr = Curve("training rays", step, _column(told, "psnr"))
    names = [name for line in told for name in line if name not in _OTHER]
    terms = [Curve(TERMS.get(n, n), step, _column(told, n)) for n in dict.fromkeys(names)]
    pace, at = _pace(told, step)
    count = Curve("Gaussians", step, _column(told, "gaussians"))
    changes = np.ptp(count.y[np.isfinite(count.y)]) if np.isfinite(count.y).any() else 0
    drawn = [
        chart("PSNR of training rays (dB)", [psnr], x_label="step", borders=borders),
        chart("terms of the loss", terms, x_label="step", log=True, borders=borders),
        chart("milliseconds a step", [Curve("ms", at, pace)], x_label="step", borders=borders),
        chart("Gaussians", [count], x_label="step", borders=borders) if changes else None,
    ]
    words = "Each point is the mean over a block of steps. Blocks in which programs were compiled "
    words += "are left out of the pace."
    return Section("Fit", [tag("div", drawn, class_="grid"), note(words)])


def stages(out: Path) -> list[tuple[str, str]]:
    """How long each stage took, from its first line of figures to its last."""
    found: dict[str, list[float]] = {}
    for line in lines(out / "metrics.jsonl"):
        found.setdefault(_stage(line), []).append(line["seconds"])
    return [(name, clock(max(x[-1] - x[0], 0.0))) for name, x in found.items() if len(x) > 1]


def last_psnr(out: Path) -> float | None:
    """PSNR of the rays of the last block of steps."""
    told = lines(out / "metrics.jsonl")
    return told[-1]["psnr"] if told else None


def requirement(report: dict[str, Any]) -> Section | None:
    """What was taken away because the training pictures do not miss it, and what was not."""
    body: list[Markup] = []
    for i, one in enumerate(report.get("segments", [report]), 1):
        if "steps" not in one:
            continue
        several = len(report.get("segments", [])) > 1
        body += [tag("h3", f"segment {i}")] if several else []
        before, after = one["before"], one["after"]
        body.append(table(
            ("", "before", "after"),
            [(_WORDS.get(name, name), _told(x), _told(after.get(name)))
             for name, x in before.items()],
        ))  # fmt: skip
        body.append(table(
            ("tried without", "taken away", "dB lost"),
            [(s["step"], "yes" if s["taken"] else "no", f"{s['loss']:.4f}") for s in one["steps"]],
        ))  # fmt: skip
    words = "A thing is taken away if that costs the training rays at most need.loss dB."
    return Section("What the scene requires", [*body, note(words)]) if body else None


_WORDS = {
    "gaussians": "Gaussians",
    "moving": "of which move",
    "heads": "heads of the field",
    "scales": "scales of its planes",
    "rows": "rows of its planes in time",
    "degree": "degree of the harmonics",
    "bytes": "bytes in memory",
    "psnr": "PSNR (dB)",
}


def _told(value: Any) -> str:
    return f"{value:,}" if isinstance(value, int) else f"{value:.2f}" if value is not None else "-"


def _stage(line: dict[str, Any]) -> str:
    part = f"{line['segment']}: " if "segment" in line else ""
    return f"{part}{line['stage']}"


def _steps(told: list[dict[str, Any]]) -> tuple[np.ndarray, list[tuple[float, str]]]:
    """Steps counted through all stages, and where each of these begins."""
    steps, borders, before, last, stage = [], [], 0, 0, None
    for line in told:
        if _stage(line) != stage:
            before, stage = before + last, _stage(line)
            borders.append((float(before), stage))
        last = line["step"]
        steps.append(before + last)
    return np.array(steps, float), borders


def _column(told: list[dict[str, Any]], name: str) -> np.ndarray:
    values = [line.get(name) for line in told]
    return np.array([np.nan if value is None else value for value in values], float)


def _pace(told: list[dict[str, Any]], step: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Milliseconds a step between two lines of one stage, and the steps at which that was."""
    seconds = _column(told, "seconds")
    same = np.array([_stage(a) == _stage(b) for a, b in zip(told, told[1:], strict=False)], bool)
    spent, done = np.diff(seconds), np.diff(step)
    good = same & (spent > 0) & (done > 0)
    pace = 1e3 * spent[good] / done[good]
    usual = np.median(pace) if len(pace) else 0.0
    kept = pace < 8 * usual
    return pace[kept], step[1:][good][kept]
