"""Take the pictures, measure our cameras on them, and judge."""

import importlib.metadata
import json
import os
import subprocess
from pathlib import Path
from typing import Any

import numpy as np

from experiments.paired_benchmark.geometry.cases import CLIP, DIFFERS, SPEED, cases
from experiments.paired_benchmark.geometry.compare import compare
from gaussray.capture.formats.paired import read_views


ROOT = Path(__file__).parents[3]
PYTHON_KEY = "GAUSSRAY_BLENDER_PYTHON"

# What is promised: a twentieth of a pixel is far below what a picture can show, and a hundredth of
# a row step moves nothing by more than a hundredth of what one row already does.
PIXELS = 0.05
ROW_STEPS = 0.01
# Rays start within a ten-thousandth of the opening's radius (of a metre); single precision at the
# walls of the box allows a hundredth of that.
ORIGIN = 1e-4
# An exposure's length, from its variance: the mean of 1024 samples per pixel is good to 1e-4.
WIDTH = 1e-3


def share_limit(pixels: int) -> float:
    """Largest difference of shares that chance leaves: exceeded once in 1,500 fair draws."""
    return 2 / np.sqrt(pixels)


def blender_python() -> str | None:
    """The interpreter that has `bpy`, as the environment names it, if any."""
    return os.environ.get(PYTHON_KEY)


def take_pictures(out: Path, size: int) -> None:
    """Render every case into a capture, in a process of its own."""
    python = blender_python()
    if python is None:
        raise RuntimeError(
            f"{PYTHON_KEY} must name a Python 3.11 that has bpy 4.5, got nothing. "
            "Make an environment for it (pip install 'bpy==4.5.*') and name its python."
        )
    module = f"{__package__}.render"
    command = [python, "-m", module, str(out.resolve()), "--size", str(size)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)} failed:\n{done.stderr[-2000:]}")


def measure(out: Path, name: str) -> dict[str, Any]:
    """Errors of one case, read as any capture is."""
    (view,) = read_views(out / f"{name}.json")
    return compare(view, SPEED * CLIP)


def misses(name: str, errors: dict[str, Any]) -> list[str]:
    """Which promises are broken; an opening that is known to differ makes none about itself."""
    limits = {
        "mask": 0,
        "image": PIXELS,
        "ray": PIXELS,
        "origin": ORIGIN,
        "time": ROW_STEPS,
        "width": WIDTH,
        **dict.fromkeys(("film", "lens", "instant"), share_limit(errors["pixels"])),
    }
    for key in ("ray", "origin", "lens") if name in DIFFERS else ():
        del limits[key]
    # Not-a-number is a miss too.
    return [
        key
        for key, limit in limits.items()
        if key in errors and not np.max(np.abs(errors[key])) <= limit
    ]


def prove(out: Path, size: int) -> bool:
    """Render, compare, print the table and write report.json; whether every promise is kept."""
    take_pictures(out, size)
    print(HEADER)
    found = {}
    for case in cases(size):
        errors = measure(out, case.name)
        broken = misses(case.name, errors)
        found[case.name] = {**errors, "misses": broken, "differs": DIFFERS.get(case.name, "")}
        print(line(case.name, found[case.name]), flush=True)
    report = {"size": size, "cases": found, "versions": versions(out, case.name)}
    (out / "report.json").write_text(json.dumps(report, indent=1) + "\n")
    missed = [name for name, errors in found.items() if errors["misses"]]
    for name, reason in DIFFERS.items():
        print(f"{name} differs: {reason}. What is not of the opening is judged.")
    print(f"{len(found) - len(missed)} of {len(found)} cases keep their promises.")
    return not missed


HEADER = (
    f"{'case':<33}{'pixels':>7}{'mask':>5}   {'ray, px: median, 99 %, max':<28}"
    f"{'image max':>10}{'origin':>9}{'time':>9}{'shares':>8}"
)


def line(name: str, errors: dict[str, Any]) -> str:
    """One row of the table; `shares` over what chance would allow is a miss above 1."""
    shares = [errors[key] for key in ("film", "lens", "instant") if key in errors]
    chance = f"{max(shares) / share_limit(errors['pixels']):8.2f}" if shares else f"{'-':>8}"
    image = f"{errors['image'][2]:10.1e}" if "image" in errors else f"{'-':>10}"
    ray = "".join(f"{value:9.1e}" for value in errors["ray"])
    verdict = ", ".join(errors["misses"]) and "  MISS " + ", ".join(errors["misses"])
    if errors["differs"]:
        verdict += "  differs"
    return (
        f"{name:<33}{errors['pixels']:>7}{errors.get('mask', '-'):>5} {ray:<29}{image}"
        f"{errors['origin'][2]:9.1e}{errors['time'][2]:9.1e}{chance}{verdict}"
    )


def versions(out: Path, name: str) -> dict[str, str]:
    """Of Blender, which wrote the pictures, and of what read them."""
    blender = json.loads((out / f"{name}.json").read_text())["info"]["blender"]
    return {"blender": blender} | {
        package: importlib.metadata.version(package) for package in ("gaussray", "jax", "numpy")
    }
