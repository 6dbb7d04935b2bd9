"""Sections of the report of a prepared capture: what was found, and what to do about it."""

from pathlib import Path
from typing import Any

from gaussray.capture.picture_file import read_levels
from gaussray.capture.spread import evenly_spread
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
    registered = sum(camera["registered"] for camera in cameras)
    total = sum(camera["pictures"] for camera in cameras)
    levels = [finding["level"] for finding in facts["findings"]]
    rate = f"at {facts['rate']:.4g} per second" if facts["rate"] else "photographs"
    rows = [
        ("cameras", str(len(cameras)), _standing(facts)),
        ("poses", f"{registered}", f"of {total} pictures"),
        ("points", f"{facts['points']:,}", ""),
        ("timestamps", str(facts["timestamps"]), rate),
        ("doubtful", str(levels.count("warn")), "findings"),
    ]
    rows += [("unusable", str(levels.count("refuse")), "findings")] * ("refuse" in levels)
    return Section("Summary", [summary_tiles(rows)])


def _standing(facts: dict[str, Any]) -> str:
    cameras = facts["cameras"].values()
    still, count = sum(camera["still"] for camera in cameras), len(cameras)
    return {0: "moving", count: "still"}.get(still, f"{still} still, {count - still} moving")


def finding_list(facts: dict[str, Any]) -> Section:
    """Every finding with its remedy, the worst first."""
    order = list(_MARKS)[::-1]
    rows = sorted(facts["findings"], key=lambda finding: order.index(finding["level"]))
    parts = []
    for finding in rows:
        mark = tag("b", _MARKS[finding["level"]], style=f"color:{_COLORS[finding['level']]}")
        text = finding["text"]
        if text.split()[0].rstrip(",:") not in facts["cameras"]:
            text = text[:1].upper() + text[1:]
        dot = "" if text.endswith(".") else "."
        remedy = tag("div", finding["remedy"], class_="note") if finding["remedy"] else None
        parts += [tag("dt", mark, f" · {finding['subject']}"), tag("dd", text, dot, remedy)]
    return Section("Findings", [tag("dl", parts, class_="facts")])


def camera_pictures(out: Path, facts: dict[str, Any]) -> Section:
    """A picture of each camera, with its name and whether it has a pose.

    Of many cameras, 30 are shown.

    Args:
        out: the capture's folder, with its pictures.
        facts: content of the capture's prepare.json (`prepare.facts.facts_of`).
    """
    names = evenly_spread(list(facts["cameras"]), _SHOWN)
    pictures = []
    for name in names:
        camera = facts["cameras"][name]
        if camera["pictures"] > 1:
            label = f"{name} · {camera['registered']} of {camera['pictures']} have a pose"
        else:
            label = name if camera["registered"] else f"{name} · no pose"
        levels = read_levels(out / camera["picture"], *camera["size"])
        pictures.append(captioned_image(levels, label, most=BYTES // (3 * len(names))))
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
    for name, camera in facts["cameras"].items():
        lens = camera.get("lens")
        sizes = ", ".join(f"{w} x {h}" for w, h in camera["sizes"])
        row = [name, sizes, str(camera["frames"])]
        row += [f"{camera['rate']:.4g}" if camera["rate"] else "-", f"{camera['offset']:+.4f}"]
        row += [f"{camera['confidence']:.2f}" if facts["sync"] not in ("none", "known") else "-"]
        if lens is None:
            rows.append([*row, "no pose", *["-"] * 6])
            continue
        row += [
            lens["camera_model"],
            f"{camera['fov']:.1f}",
            _number(camera["corner_distortion"], 100.0),
        ]
        row += [
            str(camera["observations"]),
            _number(camera["error"][0]),
            _number(camera["error"][1]),
        ]
        gains = camera["exposure"] if camera["exposure_observations"] else []
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
