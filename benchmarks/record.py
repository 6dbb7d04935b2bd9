"""How it is timed, and where the figures go.

A line of results/<bench>.jsonl is one measurement: bench, effect, scene, gaussians, rays, k,
backend, direction (forward or forward_backward), samples and, of every trace, psnr_vs_exact and
max_error against double precision (`exact.py`) in `checked` pixels; compile_s, run_s_median,
run_s_min, latency_s, fps and rays_per_s (`timed`); peak_bytes, the most that the process has held
on its device so far; entries dropped for lack of capacity; device, versions, git. A figure that
has no meaning for a bench is null. The environment's BENCH_RESULTS is another folder for them.
"""

import argparse
import importlib.metadata
import importlib.util
import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from gaussray.runtime import cuda
from gaussray.runtime.devices import cores, cpu_devices
from gaussray.runtime.provenance import git_commit
from gaussray.tracer.options import TraceOptions, on_cpu_kernel


RESULTS = Path(os.environ.get("BENCH_RESULTS") or Path(__file__).parent / "results")
KEYS = (
    "bench", "effect", "scene", "gaussians", "rays", "samples", "k", "backend", "direction",
    "compile_s", "run_s_median", "run_s_min", "latency_s", "fps", "rays_per_s", "peak_bytes",
    "device", "devices", "versions", "git", "psnr_vs_exact", "max_error", "checked", "dropped",
)  # fmt: skip
# Batches of calls whose median is taken, and about how long one of them lasts.
_BATCHES, _SECONDS, _MOST = 5, 0.1, 20


def begin(doc: str | None) -> argparse.ArgumentParser:
    """The arguments that all scripts share; all CPU cores are used."""
    use_all_cores(arrays="array" in sys.argv)
    if importlib.util.find_spec("gsplat"):
        # Leave memory to PyTorch, which shares the device.
        os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    parser = argparse.ArgumentParser(
        description=doc, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--backend", default="auto", help="auto, array or kernel")
    parser.add_argument("--jobs", type=int, default=1, help="programs of frames compiled at once")
    return parser


def use_all_cores(arrays: bool = False) -> None:
    """The devices that a command makes of a CPU, or one for each core, which `arrays` need to use
    them all; before JAX's first array."""
    try:
        jax.config.update("jax_num_cpu_devices", cores() if arrays else cpu_devices())
    except RuntimeError:
        pass  # JAX has begun, with the devices it has.


def backend(name: str) -> str:
    """What "auto" stands for here."""
    if name != "auto":
        return name
    kernel = cuda.available() or on_cpu_kernel(TraceOptions(), np.float32)
    return "kernel" if kernel else "array"


def on_cuda(name: str) -> bool:
    """Whether the CUDA kernels trace with this backend."""
    return cuda.available() and backend(name) == "kernel"


def timed(
    function: Callable, *arguments: Any, wait: Callable[[Any], Any] = jax.block_until_ready
) -> dict[str, float]:
    """Seconds of a call, as a rate and as a delay.

    Calls are made back to back and waited for once, as a program does that lets the device run
    ahead; `run_s_median` and `run_s_min` are over five such batches, `latency_s` is one call waited
    for. `compile_s` is what the first call took longer than that. `wait` returns when a result is
    there.
    """

    def once() -> float:
        began = time.perf_counter()
        wait(function(*arguments))
        return time.perf_counter() - began

    first = once()
    latency = float(np.median([once() for _ in range(3)]))
    calls = int(np.clip(_SECONDS / latency, 1, _MOST))
    seconds = []
    for _ in range(_BATCHES):
        began = time.perf_counter()
        for _ in range(calls):
            result = function(*arguments)
        wait(result)
        seconds.append((time.perf_counter() - began) / calls)
    return {
        "compile_s": round(max(first - latency, 0.0), 3),
        "run_s_median": float(np.median(seconds)),
        "run_s_min": min(seconds),
        "latency_s": latency,
    }


def record(bench: str, **figures: Any) -> dict[str, Any]:
    """Append one line to results/<bench>.jsonl and return it."""
    line: dict[str, Any] = dict.fromkeys(KEYS) | {"bench": bench} | machine() | figures
    seconds = line["run_s_median"]
    if seconds:
        line["fps"] = line["fps"] or 1 / seconds
        if line["rays"]:
            line["rays_per_s"] = line["rays"] / seconds
    RESULTS.mkdir(parents=True, exist_ok=True)
    with (RESULTS / f"{bench}.jsonl").open("a") as file:
        file.write(json.dumps(line) + "\n")
    return line


def machine() -> dict[str, Any]:
    """Device, versions and commit of a figure; GIT_COMMIT names it where there is no repository."""
    device = jax.devices()[0]
    stats = device.memory_stats() or {}
    commit = git_commit()
    return {
        "device": device.device_kind,
        "devices": len(jax.devices()),
        "peak_bytes": stats.get("peak_bytes_in_use") or _peak_of_process(),
        "versions": {n: importlib.metadata.version(n) for n in ("jax", "jaxlib", "numpy")},
        "python": sys.version.split()[0],
        "git": os.environ.get("GIT_COMMIT") or (commit.hash[:7] if commit else None),
    }


def _peak_of_process() -> int:
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def show(rows: list[dict[str, Any]], *columns: str) -> None:
    """Print lines as a table."""
    cells = [[_cell(row.get(name)) for name in columns] for row in rows]
    widths = [max(map(len, column)) for column in zip(columns, *cells, strict=True)]
    for line in (columns, *cells):
        print("  ".join(f"{x:>{w}}" for x, w in zip(line, widths, strict=True)), flush=True)


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
