"""A data set of takes: some of its pictures, and how the cameras that took them are distributed."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gaussray.report.cameras import codes_of
from gaussray.report.chart import Curve, chart
from gaussray.report.markup import Markup, tag
from gaussray.report.page import Section, note, table, tiles
from gaussray.report.picture import BYTES, still


# Takes whose first picture is shown, and keys whose distribution is drawn.
SHOWN, DRAWN = 24, 12

Takes = Sequence[Mapping[str, Any]]


def figures(takes: Takes) -> Section:
    """How much there is."""
    frames = [frame for take in takes for frame in take["frames"]]
    sizes = Counter(f"{frame['w']} x {frame['h']}" for frame in frames)
    told = [
        ("takes", f"{len(takes):,}", ""),
        ("frames", f"{len(frames):,}", ""),
        ("size", ", ".join(sorted(sizes)), "pixels"),
        ("drawn again", str(sum(take["attempt"] > 0 for take in takes)), "impossible at first"),
    ]
    labels = sorted({name for frame in frames for name in frame.get("labels", {})})
    told += [("labels", ", ".join(labels), "")] * bool(labels)
    return Section("Summary", [tiles(told)])


def pictures(out: Path, takes: Takes) -> Section:
    """The first picture of takes from all over the data set."""
    place = np.linspace(0, len(takes) - 1, min(len(takes), SHOWN)).round().astype(int)
    shown = []
    for i in place:
        take = takes[i]
        frame = take["frames"][0]
        path = out / take["folder"] / frame["file_path"]
        effect = frame.get("effect", "pinhole").replace("_", " ")
        name = f"{take['index']} · {effect}"
        shown.append(still(codes_of(path, frame["w"], frame["h"]), name, most=BYTES // len(place)))
    words = f"The first frame of {len(place)} of {len(takes)} takes, by the number of the take."
    return Section("Pictures", [tag("div", shown, class_="grid third"), note(words)])


def distributions(takes: Takes) -> Section | None:
    """Of every key that was drawn, what came out."""
    keys = [key for key in takes[0]["drawn"] if not key.endswith("seed")]
    rows, curves = [], []
    for key in keys:
        values = [take["drawn"][key] for take in takes if key in take["drawn"]]
        if all(isinstance(x, int | float) and not isinstance(x, bool) for x in values):
            rows.append((key, *(f"{np.quantile(values, q):.4g}" for q in (0, 0.25, 0.5, 0.75, 1))))
            curves.append(_cumulative(key, values))
        else:
            counts = Counter(str(x) for x in values).most_common(4)
            told = ", ".join(f"{x} ({n})" for x, n in counts)
            rows.append((key, told, "", "", "", ""))
    if not rows:
        return None
    heads = "key", "least", "quarter", "half", "three quarters", "most"
    drawn = tag("div", curves[:DRAWN], class_="grid")
    words = "Curves: the share of takes (across) whose value is below what the curve shows."
    return Section("What was drawn", [drawn, table(heads, rows), note(words)])


def _cumulative(key: str, values: Sequence[float]) -> Markup:
    share = (np.arange(len(values)) + 0.5) / len(values)
    return chart(key, [Curve(key, share, np.sort(np.asarray(values, float)))], x_label="share")
