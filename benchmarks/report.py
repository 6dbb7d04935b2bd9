"""Figures and tables of what was measured.

python -m benchmarks.report [--device H200] [--out benchmarks/figures]

Of every measurement on a device the latest line counts. `trade.png` holds the Pareto front,
`scaling.png` how the cost of a frame grows, with fitted exponents, `effects.png` frames per second
beside the paper's; `tables.md`, which is printed too, has the rest, and `report.html` shows all.
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

from benchmarks import record
from benchmarks.bench_scaling import ALONG, exponent
from benchmarks.page import write_page


matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402
from matplotlib import ticker  # noqa: E402


# 4D-GRT on an RTX 4090, frames per second.
PAPER = {
    "pinhole": 36.6,
    "fisheye": 41.5,
    "depth_of_field": 3.4,
    "rolling_shutter_16_rows": 13.5,
    "rolling_shutter_1_row": 0.76,
}
WORDS = {
    "pinhole": "pinhole",
    "fisheye": "fisheye",
    "depth_of_field": "depth of field",
    "rolling_shutter": "rolling shutter,\na time per ray",
    "rolling_shutter_16_rows": "rolling shutter,\n16-row blocks",
    "rolling_shutter_1_row": "rolling shutter,\nrow by row",
    "moving_camera": "moving camera",
    "pinhole_16_rays": "pinhole",
    "motion_blur": "motion blur",
    "everything": "everything",
    "gaussians": "Gaussians",
    "pixels": "pixels",
    "samples": "rays per pixel",
    "hits": "hits per ray",
    "devices": "devices, pictures fetched",
    "data_set": "devices, a data set written",
}
# What the panels of the trade compare with.
PANELS = {
    ("pinhole", "psnr_vs_exact"): "exact",
    ("pinhole", "psnr_same_cutoff"): "exact with the same alpha_min",
    ("rolling_shutter", "psnr_vs_exact"): "exact",
    ("depth_of_field", "psnr_vs_exact"): "exact",
}
# What tells one measurement from another.
OWN = (
    "bench", "axis", "setting", "effect", "scene", "gaussians", "rays", "samples", "keys", "k",
    "backend", "direction", "device", "devices",
)  # fmt: skip
COLUMNS = {
    "grid": ("effect", "gaussians", "rays", "keys", "backend", "ms", "dropped"),
    "trace": ("gaussians", "rays", "k", "backend", "direction", "ms", "Mrays/s", "psnr_vs_exact",
              "max_error", "dropped"),
    "deformation": ("gaussians", "keys", "direction", "ms", "max_error"),
    "reconstruct_step": ("effect", "gaussians", "rays", "backend", "ms", "dropped"),
    "render": ("effect", "scene", "gaussians", "rays", "samples", "k", "backend", "fps", "ms",
               "latency ms", "psnr_vs_exact", "max_error", "dropped"),
    "view": ("scene", "gaussians", "width", "height", "samples", "k", "tracing", "developing",
             "encoding", "fps", "dropped"),
    "scaling": ("axis", "effect", "gaussians", "rays", "samples", "hits_per_ray", "devices", "ms",
                "fps", "peak GB", "psnr_vs_exact", "dropped"),
    "worst": ("scene", "gaussians", "hits_per_ray", "backend", "ms", "ns_a_hit", "against_room",
              "psnr_vs_exact", "max_error", "dropped"),
    "trade": ("axis", "setting", "effect", "gaussians", "backend", "fps", "psnr_vs_exact",
              "max_error", "psnr_same_cutoff", "dropped"),
}  # fmt: skip
COLORS = plt.get_cmap("tab10").colors  # type: ignore[attr-defined]


def main(argv: Sequence[str] | None = None) -> None:
    """Draw and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--results", type=Path, default=record.RESULTS)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "figures")
    parser.add_argument("--device", default="", help="part of its name; else each figure's latest")
    chosen = parser.parse_args(argv)
    lines = latest(read(chosen.results))
    lines = [line for line in lines if chosen.device.lower() in line["device"].lower()]
    chosen.out.mkdir(parents=True, exist_ok=True)
    for bench, draw in (("trade", trade), ("scaling", scaling), ("render", effects)):
        own = [line for line in lines if line["bench"] == bench]
        own = [line for line in own if line["device"] == own[-1]["device"]]
        figure = draw(own) if own else None
        if figure is not None:
            figure.savefig(chosen.out / f"{draw.__name__}.png", dpi=150, bbox_inches="tight")
            plt.close(figure)
    text = "\n".join(table(bench, lines) for bench in COLUMNS)
    (chosen.out / "tables.md").write_text(text)
    write_page(chosen.out, lines, COLUMNS, _cell)
    print(text)


def read(folder: Path) -> list[dict[str, Any]]:
    """All lines, oldest first in every file."""
    files = sorted(folder.glob("*.jsonl"))
    return [json.loads(line) for file in files for line in file.read_text().splitlines() if line]


def latest(lines: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The last line of every measurement, in the order in which they were made."""
    last: dict[tuple, dict[str, Any]] = {}
    for line in lines:
        key = tuple(line.get(name) for name in OWN)
        last.pop(key, None)
        last[key] = line
    return list(last.values())


def trade(lines: list[dict[str, Any]]):
    """Frames per second against error, a panel for each effect; the front in grey."""
    lines = _alike(lines, "scene", "gaussians", "backend")
    axes = list(dict.fromkeys(line["axis"] for line in lines))
    shown = [(effect, name) for effect, name in PANELS if _of(lines, effect=effect)]
    columns = min(len(shown), 2)
    figure, panels = plt.subplots(
        -(-len(shown) // 2),
        columns,
        figsize=(6.8 * columns, 5.6 * -(-len(shown) // 2)),
        squeeze=False,
        layout="constrained",
    )
    for panel in panels.flat[len(shown) :]:
        panel.remove()
    for panel, (effect, name) in zip(panels.flat, shown, strict=False):
        own = _of(lines, effect=effect)
        if name == "psnr_same_cutoff":
            # Those with another cut-off are compared with something else.
            own = [line for line in own if line["axis"] != "alpha_min"]
        x, y = (np.array([line[n] for line in own]) for n in (name, "fps"))
        best = front(np.round(x, 1), y)
        panel.plot(x[best], y[best], color="0.8", lw=6, zorder=0, label="Pareto front")
        for axis in axes:
            some = [i for i, line in enumerate(own) if line["axis"] == axis]
            if some:
                color = COLORS[axes.index(axis) % 10]
                panel.plot(x[some], y[some], "o", ms=5, color=color, label=axis.replace("_", " "))
        panel.set(
            title=effect.replace("_", " "),
            xlabel=f"PSNR against {PANELS[effect, name]} (dB, linear light)",
            ylabel="frames per second",
            yscale="log",
        )
        _open_scale(panel, x, y)
        _labels(panel, x, y, [_name(line) for line in own])
        panel.legend(fontsize=8, loc="lower left")
    first = lines[0]
    side = round((first["rays"] / first["samples"]) ** 0.5)
    figure.suptitle(
        f"{first['scene'].replace('_', ' ')}, {first['gaussians']:,} Gaussians, {side} x {side} "
        f"pixels, {_place(first)}"
    )
    return figure


def front(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Indices of the points that none beats in both, from the most exact to the fastest."""
    order, best, kept = np.lexsort((-y, -x)), -np.inf, []
    for i in order:
        if y[i] > best:
            kept.append(i)
            best = y[i]
    return np.array(kept)


def scaling(lines: list[dict[str, Any]]):
    """Milliseconds a frame along every axis, and the power law that fits them best."""
    axes = [a for a in WORDS if _of(lines, axis=a)]
    columns, rows = min(len(axes), 3), -(-len(axes) // 3)
    figure, panels = plt.subplots(
        rows, columns, figsize=(4 * columns, 3.6 * rows), squeeze=False, layout="constrained"
    )
    for panel in panels.flat[len(axes) :]:
        panel.remove()
    for panel, axis in zip(panels.flat, axes, strict=False):
        own = _of(lines, axis=axis)
        series = list(dict.fromkeys(line["effect"] for line in own))
        for color, effect in zip(COLORS, series, strict=False):
            some = _of(own, effect=effect)
            x = np.array([line[ALONG.get(axis, "setting")] for line in some], float)
            y = np.array([1e3 * line["run_s_median"] for line in some])
            order = np.argsort(x)
            x, y = x[order], y[order]
            panel.plot(x, y, "o", color=color)
            if len(set(x)) > 1:
                power = exponent(x, y)
                level = np.exp(np.mean(np.log(y) - power * np.log(x)))
                name = f"{effect.replace('_', ' ')} " if len(series) > 1 else ""
                label = f"{name}~ x$^{{{power:.2f}}}$"
                panel.plot(x, level * x**power, color=color, alpha=0.5, label=label)
        if panel.lines[-1].get_label()[0] != "_":
            panel.legend(fontsize=8)
        y = np.array([1e3 * line["run_s_median"] for line in own])
        panel.set(xscale="log", yscale="log", xlabel=WORDS[axis], ylabel="ms per frame")
        _plain(panel.xaxis, x)
        _plain(panel.yaxis, y)
        panel.grid(alpha=0.3)
    figure.suptitle(f"one frame of the dynamic room, {_place(lines[0])}")
    return figure


def effects(lines: list[dict[str, Any]]):
    """Frames per second of every effect, beside the paper's."""
    own = [line for line in lines if line["scene"] == "dynamic_room" and line["effect"] in WORDS]
    if not own:
        return None
    sizes = [line["rays"] // line["samples"] for line in own]
    usual = max(sizes, key=sizes.count)
    own = [line for line, size in zip(own, sizes, strict=True) if size == usual]
    counts = sorted({(line["gaussians"], line["k"], line["backend"]) for line in own})
    names = [name for name in WORDS if _of(own, effect=name)]
    figure, panel = plt.subplots(
        figsize=(8, 1.2 + 0.28 * len(names) * (len(counts) + 1)), layout="constrained"
    )
    height, place = 0.8 / (len(counts) + 1), np.arange(len(names))[::-1]
    for i, (count, k, backend) in enumerate(counts):
        some = {x["effect"]: x for x in _of(own, gaussians=count, k=k, backend=backend)}
        fps = [some[name]["fps"] if name in some else np.nan for name in names]
        label = f"gaussray, {count:,} Gaussians, k = {k}, {_place(own[-1])} ({backend})"
        bars = panel.barh(place - i * height, fps, height, color=COLORS[i % 10], label=label)
        panel.bar_label(bars, [_short(v) for v in fps], padding=3, fontsize=8)
    fps = [PAPER.get(name, np.nan) for name in names]
    label = "4D-GRT as published: its own scenes, RTX 4090"
    bars = panel.barh(place - len(counts) * height, fps, height, color="0.7", label=label)
    panel.bar_label(bars, [_short(v) for v in fps], padding=3, fontsize=8)
    taken = {line["effect"]: line["samples"] for line in own}
    panel.set_yticks(
        place - len(counts) * height / 2,
        [WORDS[n] + (f" ({taken[n]} rays a pixel)" if taken[n] > 1 else "") for n in names],
    )
    panel.set(xscale="log", xlabel=f"frames per second, {usual**0.5:.0f} x {usual**0.5:.0f} pixels")
    panel.margins(x=0.15)
    panel.xaxis.set_major_formatter(lambda v, _: _tick(v))
    panel.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.12))
    return figure


def table(bench: str, lines: list[dict[str, Any]]) -> str:
    """A Markdown table for every device."""
    own, columns, text = _of(lines, bench=bench), COLUMNS[bench], ""
    for device in dict.fromkeys(line["device"] for line in own):
        some = _of(own, device=device)
        commits = ", ".join(dict.fromkeys(str(line["git"]) for line in some))
        text += f"### {bench} on {device} ({commits})\n\n"
        text += "| " + " | ".join(x.replace("_", " ") for x in columns) + " |\n"
        text += "|---" * len(columns) + "|\n"
        for line in some:
            text += "| " + " | ".join(_cell(line, name) for name in columns) + " |\n"
        text += "\n"
    return text


def _cell(line: dict[str, Any], name: str) -> str:
    derived = {
        "ms": ("run_s_median", 1e3),
        "latency ms": ("latency_s", 1e3),
        "Mrays/s": ("rays_per_s", 1e-6),
        "peak GB": ("peak_bytes", 1e-9),
    }
    key, factor = derived.get(name, (name, None))
    value = line.get(key)
    if value is None:
        return ""
    if factor:
        return _short(value * factor)
    if isinstance(value, int):
        return f"{value:,}"
    if not isinstance(value, float):
        return str(value)
    return f"{value:.1e}" if name == "max_error" else _short(value)


def _short(value: float) -> str:
    """Three digits, no powers of ten."""
    if not np.isfinite(value):
        return ""
    digits = max(2 - int(np.floor(np.log10(abs(value)))), 0) if value else 0
    return f"{value:,.{min(digits, 4)}f}"


def _of(lines: list[dict[str, Any]], **values: Any) -> list[dict[str, Any]]:
    return [line for line in lines if all(line.get(k) == v for k, v in values.items())]


def _alike(lines: list[dict[str, Any]], *names: str) -> list[dict[str, Any]]:
    """Those that share these figures with the last one."""
    return _of(lines, **{name: lines[-1][name] for name in names})


def _name(line: dict[str, Any]) -> str:
    short = {"alpha_min": "cut", "transmittance_min": "floor", "time": "", "harmonics": ""}
    word = short.get(line["axis"], line["axis"])
    return f"{'' if word == 'half' else word} {line['setting']}".strip()


def _place(line: dict[str, Any]) -> str:
    return f"{line['devices']} x {line['device']}"


def _plain(axis, values: np.ndarray) -> None:
    """Ticks at the usual 1, 2, 5; plain numbers."""
    subs = (1.0, 2.0, 5.0) if values.max() < 50 * values.min() else (1.0,)
    axis.set_major_locator(ticker.LogLocator(subs=subs))
    axis.set_major_formatter(lambda v, _: _tick(v))
    axis.set_minor_formatter(ticker.NullFormatter())


def _tick(value: float) -> str:
    for size, letter in ((1e6, "M"), (1e3, "k")):
        if value >= size:
            return f"{value / size:g}{letter}"
    return f"{value:g}"


def _open_scale(panel, x: np.ndarray, y: np.ndarray) -> None:
    """Room for labels at the right, and plain ticks."""
    wide = max(np.ptp(x), 1.0)
    panel.set_xlim(x.min() - 0.08 * wide, x.max() + 0.4 * wide)
    panel.set_ylim(y.min() / 1.4, y.max() * 1.4)
    _plain(panel.yaxis, y)
    panel.grid(alpha=0.3, which="both")


def _labels(panel, x: np.ndarray, y: np.ndarray, names: list[str]) -> None:
    """A name beside every point, moved up until it covers neither a name nor a point; points of
    several names are the base of the sweep."""
    low, high = panel.get_ylim()
    left, right = panel.get_xlim()
    words: dict[tuple[float, float], list[str]] = {}
    for a, b, name in zip(x, y, names, strict=True):
        place = (a - left) / (right - left), np.log(b / low) / np.log(high / low)
        words.setdefault(place, []).append(name)
    taken = [(a, a + 0.01, b) for a, b in words]
    for (across, up), own in sorted(words.items(), key=lambda item: item[0][::-1]):
        name = own[0] if len(own) == 1 else "base"
        begin, end, height = across + 0.03, across + 0.03 + 0.0115 * len(name), up
        while any(a < end and b > begin and abs(c - height) < 0.028 for a, b, c in taken):
            height += 0.004
        taken.append((begin, end, height))
        panel.annotate(
            name,
            (across, up),
            (begin, height),
            "axes fraction",
            textcoords="axes fraction",
            fontsize=7.5,
            va="center",
            arrowprops={"arrowstyle": "-", "color": "0.6", "lw": 0.6, "shrinkA": 0, "shrinkB": 2},
        )


if __name__ == "__main__":
    main()
