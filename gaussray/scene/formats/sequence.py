"""Exports a moving scene as a sequence: a file for each timestamp, as viewers play them."""

import json
import re
from pathlib import Path

import numpy as np

from gaussray.io.atomic import atomic_path
from gaussray.io.safe.files import read_json
from gaussray.runtime.devices import is_primary
from gaussray.scene.formats.convert import check_export, export_model, gaussians_at
from gaussray.scene.formats.usd import write_usd
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import Clip


# The file beside a sequence that says the time of each.
TIMES_FILE = "times.json"
# What the files of a sequence are called.
_FRAME = re.compile(r"frame_\d{4,}\.\w+")


def export_sequence(
    scene: Scene | Clip,
    out: Path | str,
    count: int,
    *,
    color: str = "srgb",
    degree: int = 3,
    format: str = "ply",
) -> str:
    """Export a scene at evenly spaced timestamps, the first and last of its range included.

    Args:
        scene: the scene.
        out: folder of the files `frame_0000.ply` and so on, and of `times.json`; with `usd` the
            file, which holds all timestamps.
        count: number of timestamps.
        color: as for `export_model`.
        degree: as for `export_model`.
        format: as for `export_model`.

    Returns:
        A line about what was written.

    Raises:
        ValueError: The count is below 1, or a file cannot hold the scene.
        OSError: A file cannot be written.
    """
    check_export(format)
    if count < 1:
        raise ValueError(f"count must be at least 1, got {count}.")
    begin, end = (float(x) for x in scene.time_range)
    times = [float(x) for x in np.linspace(begin, end, count)]
    if format == "usd":
        states = [gaussians_at(scene, time, color=color, degree=degree)[0] for time in times]
        if is_primary():
            write_usd(out, states, color)
        return f"{count} timestamps from {begin:g} to {end:g}."
    ending = format.removesuffix("4")
    files = [f"frame_{i:04d}.{ending}" for i in range(count)]
    for file, time in zip(files, times, strict=True):
        export_model(scene, Path(out) / file, time, color=color, degree=degree, format=format)
    if is_primary():
        for stale in _listed(Path(out)) - set(files):
            (Path(out) / stale).unlink(missing_ok=True)
        frames = [{"file": file, "time": time} for file, time in zip(files, times, strict=True)]
        with atomic_path(Path(out) / TIMES_FILE) as partial:
            partial.write_text(json.dumps({"frames": frames}, indent=1) + "\n")
    return f"{count} files, at the times {begin:g} to {end:g} ({TIMES_FILE})."


def _listed(folder: Path) -> set[str]:
    """The files of the sequence that an earlier export has left in a folder."""
    try:
        frames = read_json(folder / TIMES_FILE)["frames"]
        names = [frame["file"] for frame in frames]
    except (OSError, ValueError, KeyError, TypeError):
        return set()
    return {name for name in names if isinstance(name, str) and _FRAME.fullmatch(name)}
