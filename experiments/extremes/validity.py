"""Where float32 holds: every public numerical function against double precision.

python -m experiments.extremes.validity [--only NAME] [--out FOLDER]
"""

import argparse
import os
import time
from concurrent.futures import ThreadPoolExecutor
from itertools import chain
from pathlib import Path

import jax
import numpy as np


jax.config.update("jax_enable_x64", True)

from experiments.extremes.matter import (  # noqa: E402
    geometry_sweeps,
    loss_sweeps,
    scene_sweeps,
)
from experiments.extremes.meeting import tracer_sweeps  # noqa: E402
from experiments.extremes.optics import camera_sweeps, lens_sweeps  # noqa: E402
from experiments.extremes.sweep import Errors, Sweep, measure  # noqa: E402


FINE, FAIR = 1e-5, 1e-3
# An error that half a unit in the last place of the inputs makes too, times this, is theirs.
OWN = 4.0


def sweeps():
    """All of them."""
    return chain(
        geometry_sweeps(), scene_sweeps(), tracer_sweeps(), lens_sweeps(), camera_sweeps(),
        loss_sweeps(),
    )  # fmt: skip


def holds(places: np.ndarray, error: np.ndarray, limit: float) -> str:
    """The longest run of places with errors of at most a limit."""
    fine = np.concatenate([[False], error <= limit, [False]])
    begin, end = (np.flatnonzero(np.diff(fine.astype(int)) == way) for way in (1, -1))
    if not len(begin):
        return "nowhere"
    longest = np.argmax(end - begin)
    first, last = begin[longest], end[longest] - 1
    if last - first + 1 == len(places):
        return "all"
    return f"{places[first]:.3g} ... {places[last]:.3g}"


def worst(places: np.ndarray, error: np.ndarray, inputs: np.ndarray) -> str:
    """The largest error, where it is, and what half a unit of the inputs does there."""
    at = int(np.argmax(error))
    excuse = " (inputs)" if error[at] <= OWN * inputs[at] else ""
    return f"{error[at]:.1e} at {places[at]:.3g}{excuse}"


def row(sweep: Sweep, errors: Errors) -> list[str]:
    """A line of the table."""
    p = sweep.places
    return [
        sweep.name,
        f"{sweep.swept}, {p[0]:.3g} ... {p[-1]:.3g}",
        holds(p, errors.value, FINE),
        holds(p, errors.value, FAIR),
        worst(p, errors.value, errors.value_inputs),
        holds(p, errors.gradient, FINE),
        holds(p, errors.gradient, FAIR),
        worst(p, errors.gradient, errors.gradient_inputs),
    ]


HEAD = (
    "function", "swept", "value to 1e-5", "to 1e-3", "worst",
    "gradient to 1e-5", "to 1e-3", "worst",
)  # fmt: skip


def line(cells) -> str:
    """Cells of a Markdown table."""
    return "| " + " | ".join(cells) + " |"


COLORS = ("#2a9d5c", "#e9c46a", "#d1495b", "#7a1f2b")


def colors(error: np.ndarray) -> list[str]:
    """Green, yellow, red by size; the darkest where nothing finite is left."""
    bounds = (error > FINE).astype(int) + (error > FAIR) + ~np.isfinite(error)
    return [COLORS[i] for i in bounds]


def draw(measured: list[tuple[Sweep, Errors]], path: Path) -> None:
    """Two strips for every sweep, value above gradient; a dot where half a unit in the last place
    of the inputs does as much."""
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot as plt
    from matplotlib.patches import Patch

    figure, axes = plt.subplots(figsize=(9, 0.27 * len(measured) + 1))
    for i, (sweep, e) in enumerate(measured):
        count, p = len(sweep.places), sweep.places
        left = np.arange(count) / count
        for up, error, inputs in (
            (0, e.value, e.value_inputs),
            (0.4, e.gradient, e.gradient_inputs),
        ):
            axes.barh([i + up] * count, 1 / count, 0.38, left, color=colors(error), linewidth=0)
            own = (error > FINE) & (error <= OWN * inputs)
            axes.plot(left[own] + 0.5 / count, [i + up] * own.sum(), "k.", markersize=2)
        axes.text(-0.01, i + 0.2, f"{sweep.name}", ha="right", va="center", fontsize=6)
        told = f"{sweep.swept}: {p[0]:.2g} to {p[-1]:.2g}"
        axes.text(1.01, i + 0.2, told, ha="left", va="center", fontsize=6)
    names = "to 1e-5", "to 1e-3", "worse", "not finite"
    handles = [Patch(color=c, label=n) for c, n in zip(COLORS, names, strict=True)]
    axes.legend(
        handles=handles, ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1), frameon=False
    )
    axes.set(xlim=(0, 1), ylim=(len(measured) - 0.2, -0.4))
    axes.axis("off")
    figure.savefig(path, dpi=130, bbox_inches="tight")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="functions whose name or group holds this")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent)
    told = parser.parse_args()
    told.out.mkdir(parents=True, exist_ok=True)
    began, lines, drawn = time.perf_counter(), [line(HEAD), line(["---"] * len(HEAD))], []
    chosen = [x for x in sweeps() if told.only in f"{x.group} {x.name}"]
    # Nearly all of the time is compilation, which other threads need not wait for.
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for sweep, errors in zip(chosen, pool.map(measure, chosen), strict=True):
            drawn.append((sweep, errors))
            lines.append(line(row(sweep, errors)))
            print(lines[-1], flush=True)
    print(f"{time.perf_counter() - began:.0f} s")
    if not told.only:
        (told.out / "validity.md").write_text("\n".join(lines) + "\n")
        draw(drawn, told.out / "validity.png")


if __name__ == "__main__":
    main()
