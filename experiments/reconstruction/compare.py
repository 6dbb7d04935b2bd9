"""Reconstruct captures in several ways, score each, and print them side by side.

    python -m experiments.reconstruction.compare --captures DIR --out RUNS [--ways FILE] [way ...]

A way is a name and overrides of `gaussray reconstruct`, from FILE (ways.yaml beside this). Every
way is run on every capture DIR/<scene> and scored on its pinhole pictures: views that were learnt
from, held-out cameras, held-out times. What is there already is kept, so that a run that was
stopped goes on; several `--processes` share the work. RUNS/compare.md has the table.
"""

import argparse
import json
import multiprocessing
import os
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from omegaconf import OmegaConf


PARTS = ("train", "held_out_cameras", "held_out_times")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--captures", type=Path, required=True, help="folder of the captures")
    parser.add_argument("--out", type=Path, required=True, help="folder of the reconstructions")
    parser.add_argument("--scenes", nargs="+", help="folders in it; all, if none is named")
    parser.add_argument("--ways", type=Path, default=Path(__file__).with_name("ways.yaml"))
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=1e9, help="begin nothing after these")
    parser.add_argument("names", nargs="*", help="ways; all, if none is named")
    chosen = parser.parse_args()
    ways: dict[str, list[str]] = OmegaConf.to_container(OmegaConf.load(chosen.ways))  # type: ignore
    names = chosen.names or list(ways)
    if unknown := [name for name in names if name not in ways]:
        sys.exit(f"{chosen.ways}: has no way {unknown[0]}; it has {', '.join(ways)}.")
    scenes = chosen.scenes or sorted(p.parent.name for p in chosen.captures.glob("*/*.json"))
    scenes = list(dict.fromkeys(scenes))
    jobs = [
        (chosen.captures / scene, chosen.out / name / scene, ways[name])
        for name in names
        for scene in scenes
    ]
    jobs = [job for job in jobs if not (job[1] / "score.json").exists()]
    end = time.monotonic() + chosen.seconds
    if chosen.processes == 1:
        for job in jobs:
            run(job, end)
    else:
        with multiprocessing.get_context("spawn").Pool(chosen.processes) as pool:
            for _ in pool.imap_unordered(_run, [(job, end) for job in jobs], chunksize=1):
                pass
    text = table(chosen.out, names, scenes)
    (chosen.out / "compare.md").write_text(text)
    print(text)


def _run(work):
    run(*work)


def run(job: tuple[Path, Path, list[str]], end: float) -> None:
    """One way on one capture: reconstruct, then score."""
    from gaussray.capture.open import open_capture
    from gaussray.cli.reconstruct import reconstruct_options
    from gaussray.config.compose import compose_config
    from gaussray.evaluate import EvaluateOptions, evaluate
    from gaussray.reconstruct import reconstruct
    from gaussray.render import RenderOptions
    from gaussray.tracer.options import TraceOptions

    folder, out, overrides = job
    if time.monotonic() > end:
        return
    cfg = compose_config("reconstruct", [f"capture.path={folder}", f"out={out}", *overrides])
    (out / "checkpoint.npz").unlink(missing_ok=True)
    capture = open_capture(folder)
    began = time.monotonic()
    scene = reconstruct(capture, out, options=reconstruct_options(cfg), quiet=True)
    seconds = time.monotonic() - began
    report = evaluate(
        scene,
        capture,
        out / "evaluation",
        options=EvaluateOptions(split="all", effects=("pinhole",), images=False),
        render=RenderOptions(),
        trace=TraceOptions(),
        quiet=True,
    )
    score = report["effects"]["pinhole"]["parts"]
    facts = report["scene"] | {"seconds": seconds, "stored": (out / "scene.npz").stat().st_size}
    partial = out / "score.part"
    partial.write_text(json.dumps({"parts": score, "facts": facts, "overrides": overrides}))
    os.replace(partial, out / "score.json")
    held = score["held_out_cameras"]
    print(f"{out}: {seconds:.0f} s, {score['train']['psnr']:.2f} {held['psnr']:.2f}", flush=True)


def table(out: Path, names: list[str], scenes: list[str]) -> str:
    """Means over the scenes that every way of the table has."""
    lines = [
        "| way | scenes | training views | moving | held-out cameras | moving | held-out times | "
        "moving | worst held-out | SSIM | Gaussians | MB | s |",
        "|---" * 13 + "|",
    ]
    for name in names:
        found: dict[str, Any] = {}
        for scene in scenes:
            path = out / name / scene / "score.json"
            if path.exists():
                found[scene] = json.loads(path.read_text())
        if not found:
            continue
        values = []
        for part in PARTS:
            for key in ("psnr", "psnr_moving"):
                values.append(_mean(s["parts"].get(part, {}).get(key) for s in found.values()))
        held = {n: s["parts"]["held_out_cameras"] for n, s in found.items()}
        worst = min(row["psnr"] for row in held.values())
        ssim = _mean(row["ssim"] for row in held.values())
        facts = [s["facts"] for s in found.values()]
        size, stored, seconds = (
            _mean(f[key] for f in facts) for key in ("gaussians", "stored", "seconds")
        )
        shown = " | ".join(f"{v:.2f}" for v in values)
        lines.append(
            f"| {name} | {len(found)} | {shown} | {worst:.2f} | {ssim:.3f} | {size:.0f} | "
            f"{stored / 1e6:.2f} | {seconds:.0f} |"
        )
    return "\n".join(lines) + "\n"


def _mean(values) -> float:
    known = [v for v in values if v is not None]
    return float(np.mean(known)) if known else float("nan")


if __name__ == "__main__":
    main()
