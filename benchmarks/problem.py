"""What is measured, how it is timed, and where the figures go."""

import importlib.metadata
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from gaussray.camera.rays import Rays
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.harmonics import constant


RESULTS = Path(__file__).parent / "results"


def use_all_cores() -> None:
    """One device for each core that this process may use; before JAX's first array."""
    cores = os.cpu_count() or 1
    if hasattr(os, "sched_getaffinity"):
        cores = len(os.sched_getaffinity(0))
    jax.config.update("jax_num_cpu_devices", cores)


def room(count: int, seed: int = 0) -> Gaussians:
    """A 6 x 6 x 3 room: two thirds of the Gaussians on its walls, one third on twelve spheres.

    Log-normal scales with one thin axis, bimodal opacity, random colours: the worst case for the
    order of hits.
    """
    dice = np.random.default_rng(seed)
    on_walls, on_spheres = count - count // 3, count // 3
    size = np.array([6.0, 6.0, 3.0])
    area = np.array([18, 18, 18, 18, 36, 36.0])
    wall = dice.choice(6, on_walls, p=area / area.sum())
    axis, side = wall // 2, np.where(wall % 2, 1.0, -1.0)
    rows = np.arange(on_walls)
    flat = dice.uniform(-0.5, 0.5, (on_walls, 3)) * size
    flat[rows, axis] = side * size[axis] / 2
    spacing = 0.6 * np.sqrt(area.sum() / max(on_walls, 1))
    flat_scale = np.exp(dice.normal(np.log(spacing), 0.5, (on_walls, 3)))
    flat_scale[rows, axis] = 0.004
    flat_quat = np.eye(4)[np.zeros(on_walls, int)] + dice.normal(0, 0.02, (on_walls, 4))
    center = dice.uniform([-2, -2, -1.3], [2, 2, 0.5], (12, 3))
    radius = dice.uniform(0.15, 0.5, 12)
    ball = dice.integers(12, size=on_spheres)
    normal = dice.normal(size=(on_spheres, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    spacing = 0.6 * np.sqrt(4 * np.pi * (radius**2).sum() / max(on_spheres, 1))
    round_scale = np.exp(dice.normal(np.log(spacing), 0.4, (on_spheres, 3)))
    round_scale[:, 2] = 0.003
    turn = np.cross(np.broadcast_to([0, 0, 1.0], normal.shape), normal)
    round_quat = np.concatenate([1 + normal[:, 2:], turn], axis=1)
    opaque = dice.random(count) < 0.6
    opacity = np.where(opaque, dice.uniform(0.7, 0.99, count), dice.uniform(0.02, 0.6, count))
    arrays = (
        np.concatenate([flat, center[ball] + normal * radius[ball][:, None]]),
        np.concatenate([flat_quat, round_quat]),
        np.concatenate([flat_scale, round_scale]),
        opacity,
    )
    color = jnp.asarray(dice.random((count, 3)), jnp.float32)
    return Gaussians(*(jnp.asarray(x, jnp.float32) for x in arrays), constant(color, 0))


def room_rays(side: int, order: np.ndarray) -> Rays:
    """A 60-degree pinhole in a corner of the room, pixels in the given order."""
    eye, target = np.array([2.4, -2.4, 0.6]), np.array([0, 0, -0.4])
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    focal = side / 2 / np.tan(np.deg2rad(30))
    x, y = order % side + 0.5 - side / 2, order // side + 0.5 - side / 2
    direction = x[:, None] / focal * right - y[:, None] / focal * up + forward
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    origin = np.broadcast_to(eye, direction.shape)
    return Rays(
        jnp.asarray(origin, jnp.float32),
        jnp.asarray(direction, jnp.float32),
        jnp.zeros(len(order), jnp.float32),
    )


def timed(function: Callable, *arguments: Any, repeats: int = 15) -> dict[str, float]:
    """Seconds of the first call (compilation) and of the next: median and least, blocked."""
    began = time.perf_counter()
    jax.block_until_ready(function(*arguments))
    first = time.perf_counter() - began
    seconds = []
    for _ in range(repeats):
        began = time.perf_counter()
        jax.block_until_ready(function(*arguments))
        seconds.append(time.perf_counter() - began)
    return {
        "compile_s": round(first - min(seconds), 3),
        "run_s_median": float(np.median(seconds)),
        "run_s_min": float(min(seconds)),
    }


def record(bench: str, **figures: Any) -> dict[str, Any]:
    """Append one line to results/<bench>.jsonl and return it."""
    line = {"bench": bench, **figures, **machine()}
    RESULTS.mkdir(exist_ok=True)
    with (RESULTS / f"{bench}.jsonl").open("a") as file:
        file.write(json.dumps(line) + "\n")
    return line


def machine() -> dict[str, Any]:
    """Device, versions and commit of a figure."""
    device = jax.devices()[0]
    stats = device.memory_stats() or {}
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False
    )
    return {
        "device": device.device_kind,
        "devices": len(jax.devices()),
        "peak_bytes": stats.get("peak_bytes_in_use") or _peak_of_process(),
        "versions": {n: importlib.metadata.version(n) for n in ("jax", "jaxlib", "numpy")},
        "python": sys.version.split()[0],
        "git": commit.stdout.strip() or None,
    }


def _peak_of_process() -> int:
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def show(rows: list[dict[str, Any]], columns: tuple[str, ...]) -> None:
    """Print lines as a table."""
    print("  ".join(f"{name:>16}" for name in columns))
    for row in rows:
        cells = (row.get(name, "") for name in columns)
        print("  ".join(f"{x:>16.4g}" if isinstance(x, float) else f"{x!s:>16}" for x in cells))
