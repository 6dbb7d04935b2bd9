"""Sections of the report of a prepared capture: what was found, and what to do about it."""

from pathlib import Path
from typing import Any

import numpy as np

from gaussray.capture.picture_file import read_levels
from gaussray.report.chart import PALETTE
from gaussray.report.markup import Markup, tag
from gaussray.report.page import Section, html_table, note, summary_tiles
from gaussray.report.picture import BYTES, captioned_image, embedded_image


_MARKS = {"good": "good", "warn": "doubtful", "refuse": "unusable"}
_COLORS = {"good": "var(--c2)", "warn": "var(--c1)", "refuse": "var(--c4)"}
# Cameras whose picture is shown, at most.
_SHOWN = 30


def prepared_summary(facts: dict[str, Any]) -> Section:
    """Registered pictures, points, timestamps, and how many findings are doubtful."""
    cameras = facts["cameras"].values()
    registered = sum(one["registered"] for one in cameras)
    levels = [one["level"] for one in facts["findings"]]
    rate = f"at {facts['rate']:.4g} per second" if facts["rate"] else "photographs"
    rows = [
        ("cameras", str(len(cameras)), _standing(facts)),
        ("poses", f"{registered}", f"of {sum(one['pictures'] for one in cameras)} pictures"),
        ("points", f"{facts['points']:,}", ""),
        ("timestamps", str(facts["timestamps"]), rate),
        ("doubtful", str(levels.count("warn")), "findings"),
    ]
    rows += [("unusable", str(levels.count("refuse")), "findings")] * ("refuse" in levels)
    return Section("Summary", [summary_tiles(rows)])


def _standing(facts: dict[str, Any]) -> str:
    still, count = sum(one["still"] for one in facts["cameras"].values()), len(facts["cameras"])
    return {0: "moving", count: "still"}.get(still, f"{still} still, {count - still} moving")


def finding_list(facts: dict[str, Any]) -> Section:
    """Every finding with its remedy, the worst first."""
    order = list(_MARKS)[::-1]
    rows = sorted(facts["findings"], key=lambda one: order.index(one["level"]))
    parts = []
    for one in rows:
        mark = tag("b", _MARKS[one["level"]], style=f"color:{_COLORS[one['level']]}")
        text = one["text"]
        if text.split()[0].rstrip(",:") not in facts["cameras"]:
            text = text[:1].upper() + text[1:]
        dot = "" if text.endswith(".") else "."
        remedy = tag("div", one["remedy"], class_="note") if one["remedy"] else None
        parts += [tag("dt", mark, f" · {one['subject']}"), tag("dd", text, dot, remedy)]
    return Section("Findings", [tag("dl", parts, class_="facts")])


def camera_pictures(out: Path, facts: dict[str, Any]) -> Section:
    """A picture of each camera, with its name and whether it has a pose.

    Of many cameras, 30 are shown.

    Args:
        out: the capture's folder, with its pictures.
        facts: content of the capture's prepare.json (`prepare.facts.facts_of`).
    """
    names = list(facts["cameras"])
    indices = sorted({round(x) for x in np.linspace(0, len(names) - 1, min(len(names), _SHOWN))})
    pictures = []
    for i in indices:
        one = facts["cameras"][names[i]]
        if one["pictures"] > 1:
            label = f"{names[i]} · {one['registered']} of {one['pictures']} have a pose"
        else:
            label = names[i] if one["registered"] else f"{names[i]} · no pose"
        levels = read_levels(out / one["picture"], *one["size"])
        pictures.append(captioned_image(levels, label, most=BYTES // (3 * len(indices))))
    return Section("Pictures", [tag("div", pictures, class_="grid few")])


def epipolar_pictures(out: Path, facts: dict[str, Any]) -> Section | None:
    """Pairs of pictures: points of the left one, and their epipolar lines in the right one.

    Args:
        out: the capture's folder, with its pictures.
        facts: content of the capture's prepare.json (`prepare.facts.facts_of`).

    Returns:
        The section; None if no pair was matched.
    """
    pairs = facts["epipolar"]
    if not pairs:
        return None
    most = BYTES // (3 * len(pairs))
    figures = []
    for pair in pairs:
        first, second = pair["first"], pair["second"]
        left = _draw(out, first, [a for a, _ in pair["points"]], [], most)
        right = _draw(out, second, [b for _, b in pair["points"]], pair["lines"], most)
        distance = "unknown" if pair["distance"] is None else f"{pair['distance']:.2f} pixels"
        caption = tag(
            "figcaption",
            tag("b", f"{first['label']} and {second['label']}"),
            f" · {pair['matches']} matches, median distance from the lines {distance}",
        )
        figures.append(tag("figure", tag("div", left, right, class_="pair"), caption))
    words = (
        "Each circle on the left has a line of its colour on the right, on which the poses and "
        "lenses put the same thing; the circle there is where it was found. Circles off their "
        "lines by more than a few pixels show wrong poses or lenses; a single one, a wrong match."
    )
    return Section("Epipolar lines", [tag("div", figures, class_="grid pairs"), note(words)])


def camera_measurements(facts: dict[str, Any]) -> Section:
    """A row for each camera: clock, lens, errors, exposure."""
    rows = []
    for name, one in facts["cameras"].items():
        lens = one.get("lens")
        sizes = ", ".join(f"{w} x {h}" for w, h in one["sizes"])
        row = [name, sizes, str(one["frames"])]
        row += [f"{one['rate']:.4g}" if one["rate"] else "-", f"{one['offset']:+.4f}"]
        row += [f"{one['confidence']:.2f}" if facts["sync"] not in ("none", "known") else "-"]
        if lens is None:
            rows.append([*row, "no pose", *["-"] * 6])
            continue
        row += [lens["camera_model"], f"{one['fov']:.1f}", _number(one["corner_distortion"], 100.0)]
        row += [str(one["observations"]), _number(one["error"][0]), _number(one["error"][1])]
        gains = one["exposure"] if one["exposure_observations"] else []
        rows.append([*row, " ".join(f"{x:+.2f}" for x in gains) or "-"])
    heads = (
        *("camera", "size", "frames", "rate", "offset s", "confidence", "lens", "fov"),
        *("corner %", "observations", "median px", "90 % px", "stops r g b"),
    )
    words = (
        f"Offset: seconds added to the camera's clock (by {facts['sync']}). Fov: horizontal, in "
        "degrees. Corner: how far distortion shifts the picture's corner. Errors: distance of "
        "features from their projected points. Stops: light of a camera against the mean of "
        "all, in powers of two."
    )
    return Section("Cameras in numbers", [html_table(heads, rows), note(words)])


def _number(value: float | None, factor: float = 1.0) -> str:
    return "-" if value is None else f"{factor * value:.2f}"


def _draw(
    out: Path,
    picture: dict[str, Any],
    points: list[list[float]],
    lines: list[list[list[list[float]]]],
    most: int,
) -> Markup:
    """A picture with circles and lines on it; number k has colour k."""
    width, height = picture["size"]
    unit = max(width, height) / 400
    levels = read_levels(out / picture["file"], width, height)
    parts = [tag("image", href=embedded_image(levels, most), width=width, height=height)]
    for k, line in enumerate(lines):
        for part in line:
            path = "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in part)
            parts.append(tag("path", d=path, fill="none", stroke=_ink(k), stroke_width=unit))
    for k, (x, y) in enumerate(points):
        ring = {"cx": x, "cy": y, "r": 5 * unit, "fill": "none", "stroke_width": 1.6 * unit}
        parts.append(tag("circle", **{**ring, "stroke_width": 3 * unit}, stroke="#000"))
        parts.append(tag("circle", **ring, stroke=_ink(k)))
    view = f"0 0 {width} {height}"
    return tag("svg", parts, viewBox=view, role="img", aria_label=picture["label"])


def _ink(k: int) -> str:
    """Colour k, as bright on light pages as on dark ones: it lies on a picture."""
    return f"hsl({360 * k / PALETTE:.0f} 95% 60%)"
