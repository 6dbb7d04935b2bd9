"""Films a data set in one go, and again with two kills on the way; both must be the same bytes.

`python -m experiments.datasets.kill --out DIR [--samples 500]`: two frames of 24 x 24 pixels each.
"""

import argparse
import hashlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from gaussray.camera.aperture import no_aperture
from gaussray.camera.camera import Camera
from gaussray.camera.film import Film
from gaussray.camera.lens import pinhole
from gaussray.camera.shutter import global_shutter
from gaussray.camera.trajectory import Trajectory
from gaussray.dataset.manifest import FrameRecord, write_manifest
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.harmonics import constant_harmonics
from gaussray.scene.scene import Scene
from gaussray.scene.store import save_scene


SIDE, GAUSSIANS, TIMES = 24, 60, (0.0, 0.5)
WORDS = [
    "dataset.frames=0",
    "format=exr",
    "lens.fov=90",
    "sample.camera.names.choice=[[left],[middle],[right]]",
    "sample.lens.choice=[pinhole,equidistant]",
    "aperture.focus=sphere",
    "sample.aperture.radius.log_uniform=[0.01,0.2]",
    "sample.aperture.focus_distance.uniform=[2,4]",
    "shutter=rolling",
    "sample.shutter.readout.uniform=[0,0.3]",
    "sample.sensor.exposure={normal:[0,1],within:[-2,2]}",
    "sensor.full_well=2000",
    "sensor.read_noise=2",
]


def write_scene(folder: Path) -> None:
    """Random Gaussians in front of three cameras, side by side."""
    chance = np.random.default_rng(0)
    mean = chance.uniform(-1, 1, (GAUSSIANS, 3))
    scale, color = chance.uniform(0.05, 0.3, (GAUSSIANS, 3)), chance.uniform(0, 1, (GAUSSIANS, 3))
    parts = mean, chance.normal(size=(GAUSSIANS, 4)), scale, np.full(GAUSSIANS, 0.9)
    still = Gaussians(*(_single(x) for x in parts), constant_harmonics(_single(color), 0))
    nothing = Gaussians(*(x[:0] for x in (still.mean, still.quat, still.scale, still.opacity)),
                        still.harmonics[:0])  # fmt: skip
    save_scene(folder / "scene.npz", Scene(still, nothing, None, _single([0, 1])))
    lens = pinhole(_single([SIDE, SIDE]), _single([SIDE / 2, SIDE / 2]))
    records = []
    for name, x in {"left": -0.5, "middle": 0.0, "right": 0.5}.items():
        path = Trajectory(_single([0]), _single([[1, 0, 0, 0]]), _single([[x, 0, -3]]))
        for i, time_ in enumerate(TIMES):
            camera = Camera(
                Film(SIDE, SIDE, "box"), lens, no_aperture(), global_shutter(), path, _single(time_)
            )
            records.append(FrameRecord(f"images/{name}/{i:04d}.png", camera, name, "test"))
    write_manifest(folder / "cameras.json", records)


def _single(x) -> jnp.ndarray:
    return jnp.asarray(x, jnp.float32)


def film(scene: Path, out: Path, samples: int, stop: int | None = None) -> float:
    """Run the command, to its end or until `stop` pictures are there; seconds."""
    words = ["render", f"scene={scene}", f"out={out}", f"dataset.count={samples}", *WORDS]
    # What one run has compiled the next ones load.
    cache = {"JAX_COMPILATION_CACHE_DIR": str(scene / "compiled")}
    began = time.monotonic()
    with (out.parent / f"{out.name}.log").open("a") as log:
        run = subprocess.Popen(
            [sys.executable, "-m", "gaussray.cli", *words],
            env={**os.environ, **cache}, stdout=log, stderr=log,
        )  # fmt: skip
        while run.poll() is None:
            time.sleep(0.05)
            if stop is not None and len(pictures(out)) >= stop:
                run.send_signal(signal.SIGKILL)
                run.wait()
    if run.returncode != (0 if stop is None else -signal.SIGKILL):
        raise SystemExit(f"{out}: the command ended with {run.returncode}, see {out}.log.")
    return time.monotonic() - began


def pictures(out: Path) -> list[Path]:
    """Finished pictures; those that are being written have a dot in front."""
    return [path for path in out.glob("takes/*/images/*/*/*.exr") if path.name[0] != "."]


def digests(out: Path) -> dict[str, str]:
    """SHA-256 of every file, by its path."""
    return {
        str(path.relative_to(out)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(out.rglob("*"))
        if path.is_file() and path.name != "report.html"  # which names its folder
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="an empty folder")
    parser.add_argument("--samples", type=int, default=500)
    chosen = parser.parse_args()
    scene, frames = chosen.out / "scene", len(TIMES) * chosen.samples
    write_scene(scene)
    whole, broken = chosen.out / "whole", chosen.out / "broken"
    print(f"undisturbed: {film(scene, whole, chosen.samples):.0f} s", flush=True)
    for part in (1, 2):
        seconds = film(scene, broken, chosen.samples, part * frames // 3)
        left = {path: path.stat() for path in pictures(broken)}
        half = sum(1 for _ in broken.rglob(".*.part*"))
        there = f"{len(left)} of {frames} pictures, {half} half written"
        print(f"killed after {seconds:.0f} s: {there}", flush=True)
        if part == 1:
            first = left
    print(f"to its end: {film(scene, broken, chosen.samples):.0f} s", flush=True)
    again = [path for path, old in {**left, **first}.items() if changed(path, old)]
    one, two = digests(whole), digests(broken)
    differing = [name for name in one.keys() | two.keys() if one.get(name) != two.get(name)]
    print(f"{len(one)} files, {len(pictures(whole))} pictures; "
          f"{len(again)} rendered twice; {len(differing)} differ: {differing[:5]}")  # fmt: skip
    raise SystemExit(bool(again or differing))


def changed(path: Path, old: os.stat_result) -> bool:
    """Whether a picture was written anew."""
    new = path.stat()
    return (new.st_ino, new.st_mtime_ns) != (old.st_ino, old.st_mtime_ns)


if __name__ == "__main__":
    main()
