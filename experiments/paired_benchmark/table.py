"""Reconstruct and score the benchmark's scenes, and print the paper's tables with ours beside them.

    python -m experiments.paired_benchmark.table --captures DIR --out RUNS [key=value ...]

For each capture DIR/<scene>: `gaussray reconstruct` into RUNS/<scene> (with the key=value
overrides), `gaussray evaluate` of all splits, and again of the rolling shutter in chunks of 1, 4
and 16 rows (--chunks). What is there already is kept: if stopped, it goes on where it was. The
tables are also written to RUNS/table.md, the figures to RUNS/table.json.
"""

import argparse
import json
import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np


GAUSSRAY = [sys.executable, "-c", "from gaussray.cli import main; main()"]
CHUNKS = (1, 4, 16)
# The paper's tables (512 x 512, RTX 4090; every view and frame learnt from and scored):
# PSNR, SSIM, LPIPS, frames a second.
PAPER = {
    "pinhole": {
        "HexPlane": (23.11, 0.796, 0.294, 0.20),
        "MSTH": (29.43, 0.902, 0.114, 9.38),
        "4D-GRT": (32.80, 0.890, 0.102, 36.56),
    },
    "depth_of_field": {
        "HexPlane": (18.37, 0.734, 0.506, 0.01),
        "MSTH": (28.47, 0.901, 0.154, 0.57),
        "4D-GRT": (31.25, 0.912, 0.121, 3.44),
    },
    "fisheye": {
        "HexPlane": (15.65, 0.668, 0.414, 0.21),
        "MSTH": (24.42, 0.816, 0.176, 9.38),
        "4D-GRT": (24.13, 0.816, 0.168, 41.53),
    },
    "fisheye, inside the disc": {
        "HexPlane": (21.69, 0.748, 0.273, None),
        "MSTH": (26.79, 0.857, 0.115, None),
        "4D-GRT": (28.89, 0.856, 0.126, None),
    },
    "rolling_shutter": {
        "HexPlane": (21.35, 0.772, 0.316, 0.21),
        "MSTH": (28.70, 0.893, 0.119, 9.35),
        "4D-GRT, 1 row": (31.6144, None, None, 0.76),
        "4D-GRT, 4 rows": (31.6146, None, None, 4.99),
        "4D-GRT, 16 rows": (31.6082, 0.882, 0.106, 13.54),
    },
}
PAPER_COST = {"HexPlane": ("12 h", 238.0), "MSTH": ("8 min", 889.0), "4D-GRT": ("3 h", 364.9)}
PARTS = {"train": "training views", "held_out_times": "held-out times"}
PARTS |= {"held_out_cameras": "held-out cameras"}
DIFFERS = """What differs from the paper's tables: the scenes (the paper's are not published; these
are procedural and fully described here), the size and number of pictures (above), the machine, and
the protocol: the paper fits and scores the same views and frames, which compares only with
"training views"; `--held-cameras 0 --held-frames 0` follows it. PSNR and SSIM are means over
pictures, then over scenes; FPS is frames after compilation, deformation and acceleration structure
included. LPIPS and FLIP are there if their packages are. Flicker is how much pixels that never move
tremble, in codes of 255, and in brackets how much the truth's do."""


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--captures", type=Path, required=True, help="folder of the captures")
    parser.add_argument("--out", type=Path, required=True, help="folder of the reconstructions")
    parser.add_argument("--scenes", nargs="+", help="folders in it; all, if none is named")
    parser.add_argument("--no-pictures", action="store_true", help="figures alone, no pictures")
    parser.add_argument("--chunks", nargs="*", type=int, default=CHUNKS, help="rows a chunk")
    parser.add_argument("overrides", nargs="*", help="key=value for gaussray reconstruct")
    chosen = parser.parse_args()
    found = sorted(path.parent.name for path in chosen.captures.glob("*/transforms.json"))
    missing = [name for name in chosen.scenes or found if name not in found]
    if missing or not found:
        sys.exit(
            f"{chosen.captures}: holds no capture {missing[0] if missing else ''}. Make it by "
            "`python -m experiments.paired_benchmark.generate`."
        )
    reports = {}
    for name in chosen.scenes or found:
        reports[name] = report(
            chosen.captures / name,
            chosen.out / name,
            chosen.overrides,
            pictures=not chosen.no_pictures,
            chunks=chosen.chunks,
        )
        text = tables(reports)
        (chosen.out / "table.md").write_text(text)
        (chosen.out / "table.json").write_text(json.dumps(reports, indent=1) + "\n")
    print(text)


def report(
    capture: Path, out: Path, overrides: list[str], *, pictures: bool, chunks: Sequence[int]
) -> dict[str, Any]:
    """Figures of one scene, made unless they are there."""
    if not (out / "scene.npz").exists():
        resume = ["resume=true"] if (out / "checkpoint.npz").exists() else []
        gaussray("reconstruct", f"capture.path={capture}", f"out={out}", *resume, *overrides)
    common = ["evaluate", f"scene={out}", f"truth={capture}", "evaluate.split=all"]
    whole = scored(out / "evaluation", *common, f"evaluate.images={str(pictures).lower()}")
    rows = [effect for effect in whole["effects"] if effect == "rolling_shutter"]
    for chunk in chunks if rows else ():
        only = "evaluate.effects=[rolling_shutter]", "evaluate.images=false"
        way = f"render.chunk_rows={chunk}"
        own = scored(out / f"evaluation_{chunk}_rows", *common, *only, way)
        whole["effects"][f"rolling_shutter, {rows_of(chunk)}"] = own["effects"]["rolling_shutter"]
    whole["seconds"] = seconds(out / "metrics.jsonl")
    whole["stored"] = (out / "scene.npz").stat().st_size
    whole["capture"] = described(capture)
    return whole


def scored(out: Path, *words: str) -> dict[str, Any]:
    if not (out / "report.json").exists():
        gaussray(*words, f"out={out}")
    return json.loads((out / "report.json").read_text())


def gaussray(*words: str) -> None:
    print("gaussray", shlex.join(words), flush=True)
    done = subprocess.run([*GAUSSRAY, *words])
    if done.returncode:
        sys.exit(f"stopped at `gaussray {shlex.join(words)}`. Run this again to go on.")


def rows_of(chunk: int) -> str:
    return f"{chunk} row{'s' * (chunk > 1)} a chunk"


def seconds(metrics: Path) -> float:
    """Of fitting, over all its runs: each begins anew at 0."""
    clock = [json.loads(line)["seconds"] for line in metrics.read_text().splitlines()]
    return sum(a for a, b in zip(clock, [*clock[1:], 0.0], strict=True) if b < a)


def described(capture: Path) -> dict[str, Any]:
    """Size of the pictures and how many a reconstruction has."""
    content = json.loads((capture / "transforms.json").read_text())
    return {"width": content["w"], "height": content["h"], "pictures": len(content["frames"])}


def tables(reports: dict[str, dict[str, Any]]) -> str:
    """Markdown: every effect beside the paper's figures, the worst scene, costs, every scene."""
    first = next(iter(reports.values()))
    size = first["capture"]
    lines = [
        f"{len(reports)} scenes, {size['width']} x {size['height']} pixels, {size['pictures']} "
        f"pinhole pictures a scene; {first['versions']['device']}.",
        "",
        "| effect | | PSNR | SSIM | LPIPS | FLIP | moving PSNR | flicker (truth's) | FPS | "
        "worst scene |",
        "|---" * 10 + "|",
    ]
    effects = list(dict.fromkeys(name for report in reports.values() for name in report["effects"]))
    for effect in effects:
        per_scene = {n: r["effects"][effect] for n, r in reports.items() if effect in r["effects"]}
        named = effect.replace("_", " ")
        for part, label in split_of(per_scene):
            own = {n: row.get("parts", {part: row}).get(part, {}) for n, row in per_scene.items()}
            lines.append(ours(named, label, own, len(reports)))
            if effect == "fisheye":
                disc = {n: inside(row, "circle") for n, row in own.items()}
                lines.append(ours("fisheye, inside the disc", label, disc, len(reports)))
        lines += theirs(effect)
        lines += theirs("fisheye, inside the disc") if effect == "fisheye" else []
    lines += ["", *costs(reports), "", *scenes(reports), "", DIFFERS, ""]
    return "\n".join(lines)


def split_of(per_scene):
    """(part, label) of what an effect was scored on."""
    parts = {part for row in per_scene.values() for part in row.get("parts", ())}
    return [(part, PARTS[part]) for part in PARTS if part in parts] or [("", "")]


def inside(row, mask):
    return {"psnr": row.get(f"psnr_{mask}"), "ssim": row.get(f"ssim_{mask}")}


def ours(effect, label, own, scenes):
    named = f"gaussray, {label}" if label else "gaussray"
    named += f" ({len(own)} of {scenes} scenes)" if len(own) < scenes else ""
    keys = {"psnr": 2, "ssim": 3, "lpips": 3, "flip": 3, "psnr_moving": 2, "flicker": 2}
    shown = " | ".join(figure(mean(own, key), digits) for key, digits in keys.items())
    shown += f" ({figure(mean(own, 'flicker_truth'), 2)}) | {figure(mean(own, 'fps'), 1)}"
    known = {name: row["psnr"] for name, row in own.items() if row.get("psnr") is not None}
    worst = min(known, key=known.__getitem__) if known else None
    last = f"{known[worst]:.2f} {worst}" if worst else "-"
    return f"| {effect} | {named} | {shown} | {last} |"


def theirs(effect):
    return [
        f"| {effect.replace('_', ' ')} | *{method}* | {figure(p, 2)} | {figure(s, 3)} | "
        f"{figure(lp, 3)} | - | - | - | {figure(fps, 2)} | - |"
        for method, (p, s, lp, fps) in PAPER.get(effect, {}).items()
    ]


def costs(reports):
    spent = np.mean([report["seconds"] for report in reports.values()])
    stored = np.mean([report["stored"] for report in reports.values()]) / 1e6
    lines = ["| | fitting | storage, MB |", "|---|---|---|"]
    lines.append(f"| gaussray | {spent / 60:.1f} min | {stored:.1f} |")
    return lines + [f"| *{name}* | {time} | {size} |" for name, (time, size) in PAPER_COST.items()]


def scenes(reports):
    names = ("pinhole", "fisheye", "depth_of_field", "rolling_shutter")
    lines = [
        "| scene | training views | held-out cameras | moving | held-out times | fisheye | "
        "depth of field | rolling shutter | Gaussians | moving | MB | min |",
        "|---" * 12 + "|",
    ]
    for scene, report in reports.items():
        row = {name: report["effects"].get(name, {}) for name in names}
        parts = row["pinhole"].get("parts", {})
        held = parts.get("held_out_cameras", {})
        values = [
            *(parts.get("train", {}).get("psnr"), held.get("psnr"), held.get("psnr_moving")),
            parts.get("held_out_times", {}).get("psnr"),
            *(row[name].get("psnr") for name in names[1:]),
        ]
        facts = report["scene"]
        lines.append(
            f"| {scene} | "
            + " | ".join(figure(value, 2) for value in values)
            + f" | {facts['gaussians']} | {facts['moving']} | {report['stored'] / 1e6:.1f} | "
            f"{report['seconds'] / 60:.1f} |"
        )
    return lines


def mean(own, key):
    values = [row[key] for row in own.values() if row.get(key) is not None]
    return float(np.mean(values)) if values else None


def figure(value, digits):
    return "-" if value is None else f"{value:.{digits}f}"


if __name__ == "__main__":
    main()
