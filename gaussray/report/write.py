"""The page of a run, from the files it has left and what it had in hand."""

from pathlib import Path
from typing import Any

from gaussray.capture.formats.paired import PINHOLE_FILE, Capture, View, read_cameras, read_capture
from gaussray.dataset.takes import read_takes
from gaussray.io.atomic import whole
from gaussray.report import (
    calibration as adjusted,
    cameras as shown,
    dataset as taken,
    evaluation as scored,
    reconstruction as fitted,
)
from gaussray.report.markup import Markup
from gaussray.report.page import Section, page, tiles
from gaussray.report.run import clock, document, reproduce, size, subtitle
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import Clip


_Sections = list[Section | None]

FILE = "report.html"
TITLES = {
    "demo": "Demonstration",
    "reconstruct": "Reconstruction",
    "evaluate": "Evaluation",
    "render": "Pictures",
    "takes": "Takes",
    "calibrate": "Calibration",
}


def write_page(
    verb: str, out: Path, *, scene: Scene | Clip | None = None, capture: Capture | None = None
) -> Path:
    """Write `out`/report.html of a verb of TITLES, with what it made or scored (`scene`) and what
    it learnt from or was compared with (`capture`), as far as these are known."""
    sections = _SECTIONS[verb](out, scene, capture)
    with whole(out / FILE) as partial:
        partial.write_text(page(TITLES[verb], subtitle(out), sections), encoding="utf-8")
    return out / FILE


def _reconstructed(out: Path, scene: Scene | Clip | None, capture: Capture | None) -> _Sections:
    return [
        _summary(out),
        shown.samples(scene, capture) if scene is not None and capture is not None else None,
        fitted.curves(out),
        fitted.requirement(document(out / "requirement.json")),
        shown.cameras(_views(out, capture), scene, shown.SPLITS),
        reproduce(out, fitted.stages(out)),
    ]


def _scored(out: Path, scene: Scene | Clip | None, capture: Capture | None) -> _Sections:
    report = document(out / "report.json")
    groups = _groups(capture, list(report["effects"]))
    views = [view for some in groups.values() for view in some]
    return [
        _summary(out),
        scored.scores(report),
        scored.pictures(out),
        scored.over_time(out),
        shown.effects(groups, capture.time_unit) if capture else None,
        shown.cameras(views, scene, shown.SPLITS) if views else None,
        reproduce(out, _timings(report)),
    ]


def _demonstrated(out: Path, scene: Scene | Clip | None, capture: Capture | None) -> _Sections:
    first, *middle, last = _scored(out, scene, capture)
    return [first, *middle, fitted.curves(out), last]


def _rendered(out: Path, scene: Scene | Clip | None, capture: Capture | None) -> _Sections:
    # What was filmed is a capture again.
    made = read_capture(out)
    groups = _groups(made, None)
    views = [view for some in groups.values() for view in some]
    return [
        Section("Summary", [tiles(_filmed(groups))]),
        shown.films(out, groups),
        shown.effects(groups, made.time_unit),
        shown.cameras(views, scene, {split: "filmed from here" for split in _splits(views)}),
        reproduce(out, []),
    ]


def _taken(out: Path, scene: Scene | Clip | None, capture: Capture | None) -> _Sections:
    takes = list(read_takes(out))
    return [
        taken.figures(takes),
        taken.pictures(out, takes),
        taken.distributions(takes),
        reproduce(out, []),
    ]


def _calibrated(out: Path, scene: Scene | Clip | None, capture: Capture | None) -> _Sections:
    report = document(out / "report.json")
    name = report["effect"]
    views = read_cameras(out / (PINHOLE_FILE if name == "pinhole" else f"{name}.json"))
    return [
        adjusted.figures(report),
        adjusted.parameters(report),
        adjusted.levels(report),
        shown.effects({name: views}, capture.time_unit) if capture else None,
        shown.cameras(views, scene, shown.SPLITS),
        reproduce(out, []),
    ]


_SECTIONS = {
    "demo": _demonstrated,
    "reconstruct": _reconstructed,
    "evaluate": _scored,
    "render": _rendered,
    "takes": _taken,
    "calibrate": _calibrated,
}


def _filmed(groups: dict[str, list[View]]) -> list[tuple[str, str, str]]:
    """How many pictures there are, of which size, through how many rays."""
    views = [view for some in groups.values() for view in some]
    sizes = {f"{view.width} x {view.height}" for view in views}
    told = [(name.replace("_", " "), str(len(some)), "pictures") for name, some in groups.items()]
    cameras = {view.camera_name for view in views}
    told += [("cameras", str(len(cameras)), ""), ("size", ", ".join(sorted(sizes)), "pixels")]
    samples = sorted({view.samples for view in views if view.samples})
    return told + [("rays per pixel", ", ".join(map(str, samples)), "")] * bool(samples)


def _summary(out: Path) -> Section:
    """The figures to be seen first."""
    report, told = document(out / "report.json"), []
    psnr = fitted.last_psnr(out)
    for name, row in list(report.get("effects", {}).items())[:4]:
        if row.get("psnr") is not None:
            told.append((name.replace("_", " "), f"{row['psnr']:.2f}", "dB"))
    if psnr is not None and not report:
        told.append(("training rays", f"{psnr:.2f}", "dB"))
    facts = report.get("scene") or _after(document(out / "requirement.json"))
    if facts:
        told.append(("Gaussians", f"{facts['gaussians']:,}", f"{facts['moving']:,} move"))
    file = out / "scene.npz"
    if file.is_file():
        told.append(("scene.npz", *size(file.stat().st_size)))
    return Section("Summary", [tiles(told)] if told else [Markup("")])


def _after(required: dict[str, Any]) -> dict[str, Any]:
    return required.get("after", {})


def _timings(report: dict[str, Any]) -> list[tuple[str, Any]]:
    return [(name, clock(x)) for name, x in report.get("seconds", {}).items() if name != "total"]


def _views(out: Path, capture: Capture | None) -> list[View]:
    """The cameras as refined, where they were written, else as recorded."""
    path = out / "cameras.json"
    return read_cameras(path) if path.is_file() else capture.views if capture else []


def _groups(capture: Capture | None, names: list[str] | None) -> dict[str, list[View]]:
    """Views by effect, those of these names."""
    if capture is None:
        return {}
    groups = {"pinhole": capture.views, **capture.effects}
    return {n: views for n, views in groups.items() if views and (names is None or n in names)}


def _splits(views: list[View]) -> list[str]:
    return list(dict.fromkeys(view.split for view in views))
