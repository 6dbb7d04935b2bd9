"""Sections of a dataset report: some pictures, and the distributions of random settings."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gaussray.capture.spread import evenly_spread
from gaussray.report.cameras import screen_levels
from gaussray.report.chart import Curve, chart
from gaussray.report.markup import Markup, tag
from gaussray.report.page import Section, html_table, note, summary_tiles
from gaussray.report.picture import BYTES, captioned_image


# Samples whose first picture is shown, and keys whose distribution is drawn.
SHOWN, DRAWN = 24, 12

# Lines of a dataset's manifest, one for each sample (`sample_manifest.read_samples`).
Samples = Sequence[Mapping[str, Any]]


def dataset_summary(samples: Samples) -> Section:
    """Number of samples and frames, picture sizes, labels."""
    frames = [frame for sample in samples for frame in sample["frames"]]
    sizes = Counter(f"{frame['w']} x {frame['h']}" for frame in frames)
    rows = [
        ("samples", f"{len(samples):,}", ""),
        ("frames", f"{len(frames):,}", ""),
        ("size", ", ".join(sorted(sizes)), "pixels"),
        (
            "redrawn",
            str(sum(sample["attempt"] > 0 for sample in samples)),
            "samples whose first random camera was impossible",
        ),
    ]
    labels = sorted({name for frame in frames for name in frame.get("labels", {})})
    rows += [("labels", ", ".join(labels), "")] * bool(labels)
    return Section("Summary", [summary_tiles(rows)])


def sample_pictures(out: Path, samples: Samples) -> Section:
    """The first picture of samples spread over the dataset.

    Args:
        out: folder of the dataset.
        samples: lines of its manifest.
    """
    shown = evenly_spread(samples, SHOWN)
    pictures = []
    for sample in shown:
        frame = sample["frames"][0]
        path = out / sample["folder"] / frame["file_path"]
        effect = frame.get("effect", "pinhole").replace("_", " ")
        name = f"{sample['index']} · {effect}"
        pictures.append(
            captioned_image(
                screen_levels(path, frame["w"], frame["h"]), name, most=BYTES // len(shown)
            )
        )
    words = f"The first frame of {len(shown)} of {len(samples)} samples, with the sample's index."
    return Section("Pictures", [tag("div", pictures, class_="grid third"), note(words)])


def distribution_section(samples: Samples) -> Section | None:
    """Table and curves of the values of every randomized key."""
    keys = [key for key in samples[0]["drawn"] if not key.endswith("seed")]
    rows, curves = [], []
    for key in keys:
        values = [sample["drawn"][key] for sample in samples if key in sample["drawn"]]
        if all(isinstance(x, int | float) and not isinstance(x, bool) for x in values):
            rows.append((key, *(f"{np.quantile(values, q):.4g}" for q in (0, 0.25, 0.5, 0.75, 1))))
            curves.append(_cumulative(key, values))
        else:
            counts = Counter(str(x) for x in values).most_common(4)
            common = ", ".join(f"{x} ({n})" for x, n in counts)
            rows.append((key, common, "", "", "", ""))
    if not rows:
        return None
    heads = "key", "minimum", "25 %", "median", "75 %", "maximum"
    drawn = tag("div", curves[:DRAWN], class_="grid")
    words = (
        "Curves: cumulative distributions. Across: the fraction of samples with a smaller value."
    )
    return Section("Random settings", [drawn, html_table(heads, rows), note(words)])


def _cumulative(key: str, values: Sequence[float]) -> Markup:
    share = (np.arange(len(values)) + 0.5) / len(values)
    return chart(
        key, [Curve(key, share, np.sort(np.asarray(values, float)))], x_label="fraction of samples"
    )
