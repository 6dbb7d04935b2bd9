"""Writes report.html of a run from the files in its folder."""

from pathlib import Path
from typing import Any

import numpy as np

from gaussray.capture.capture import Capture, View
from gaussray.capture.formats.paired import read_cameras, read_capture
from gaussray.capture.formats.transforms import PINHOLE_FILE, effect_file
from gaussray.dataset.sample_manifest import read_samples
from gaussray.evaluate.found_cameras import with_found_cameras
from gaussray.io.atomic import atomic_path
from gaussray.render.rig.fitted_cameras import read_fitted_cameras
from gaussray.report import calibration, cameras, dataset, evaluation, reconstruction
from gaussray.report.markup import Markup
from gaussray.report.page import Section, html_page, summary_tiles
from gaussray.report.run import duration, file_size, how_to_reproduce, json_document, subtitle
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import Clip


_Sections = list[Section | None]

REPORT_FILE = "report.html"
TITLES = {
    "demo": "Demonstration",
    "reconstruct": "Reconstruction",
    "evaluate": "Evaluation",
    "render": "Pictures",
    "dataset": "Dataset",
    "calibrate": "Calibration",
    "prepare": "Prepared capture",
}


def write_page(
    command: str, out: Path, *, scene: Scene | Clip | None = None, capture: Capture | None = None
) -> Path:
    """Write report.html into the output folder of a run.

    Args:
        command: a subcommand of `TITLES`, such as `reconstruct`; `dataset` is one that
            `render` has generated (`dataset.count`).
        out: the run's output folder, with the files that the subcommand has written.
        scene: the scene that was reconstructed or scored, for drawings and sample pictures.
        capture: the capture that it was trained on or compared with.

    Returns:
        The path of report.html.

    Raises:
        KeyError: If `command` is not in `TITLES`.
        OSError: If the file cannot be written.
    """
    sections = _SECTIONS[command](out, scene, capture)
    with atomic_path(out / REPORT_FILE) as partial:
        partial.write_text(html_page(TITLES[command], subtitle(out), sections), encoding="utf-8")
    return out / REPORT_FILE


def _reconstruct_sections(
    out: Path, scene: Scene | Clip | None, capture: Capture | None
) -> _Sections:
    return [
        _summary(out),
        cameras.rendered_samples(scene, with_found_cameras(capture, out))
        if scene is not None and capture is not None
        else None,
        reconstruction.training_curves(out),
        reconstruction.pruning(json_document(out / "requirement.json")),
        cameras.camera_plan(_views(out, capture), scene, cameras.SPLITS),
        how_to_reproduce(out, reconstruction.stage_durations(out)),
    ]


def _evaluate_sections(out: Path, scene: Scene | Clip | None, capture: Capture | None) -> _Sections:
    report = json_document(out / "report.json")
    groups = _groups(capture, list(report["effects"]))
    views = [view for group in groups.values() for view in group]
    return [
        _summary(out),
        evaluation.score_table(report),
        evaluation.compared_pictures(out),
        evaluation.psnr_over_time(out),
        cameras.camera_table(groups, capture.time_unit) if capture else None,
        cameras.camera_plan(views, scene, cameras.SPLITS) if views else None,
        how_to_reproduce(out, _timings(report)),
    ]


def _demo_sections(out: Path, scene: Scene | Clip | None, capture: Capture | None) -> _Sections:
    first, *middle, last = _evaluate_sections(out, scene, capture)
    return [first, *middle, reconstruction.training_curves(out), last]


def _render_sections(out: Path, scene: Scene | Clip | None, capture: Capture | None) -> _Sections:
    # A rendered dataset is read like a capture.
    rendered = read_capture(out)
    groups = _groups(rendered, None)
    views = [view for group in groups.values() for view in group]
    return [
        Section("Summary", [summary_tiles(_picture_counts(groups))]),
        cameras.picture_sequences(out, groups),
        cameras.camera_table(groups, rendered.time_unit),
        cameras.camera_plan(views, scene, {split: "rendered cameras" for split in _splits(views)}),
        how_to_reproduce(out, []),
    ]


def _dataset_sections(out: Path, scene: Scene | Clip | None, capture: Capture | None) -> _Sections:
    samples = list(read_samples(out))
    return [
        dataset.dataset_summary(samples),
        dataset.sample_pictures(out, samples),
        dataset.distribution_section(samples),
        how_to_reproduce(out, []),
    ]


def _calibrate_sections(
    out: Path, scene: Scene | Clip | None, capture: Capture | None
) -> _Sections:
    report = json_document(out / "report.json")
    name = report["effect"]
    views = read_cameras(out / effect_file(name))
    return [
        calibration.calibration_summary(report),
        calibration.parameter_table(report),
        calibration.level_table(report),
        cameras.camera_table({name: views}, capture.time_unit) if capture else None,
        cameras.camera_plan(views, scene, cameras.SPLITS),
        how_to_reproduce(out, []),
    ]


def _prepare_sections(out: Path, scene: Scene | Clip | None, capture: Capture | None) -> _Sections:
    # Imported here: that loads what prepares captures, which no other page needs.
    from gaussray.report import prepare

    facts = json_document(out / "prepare.json")
    views = read_cameras(out / PINHOLE_FILE) if (out / PINHOLE_FILE).is_file() else []
    return [
        prepare.prepared_summary(facts),
        prepare.finding_list(facts),
        prepare.camera_pictures(out, facts),
        prepare.epipolar_pictures(out, facts),
        prepare.camera_measurements(facts),
        cameras.camera_plan(_first_of_each(views), None, {"train": "cameras"}) if views else None,
        how_to_reproduce(out, []),
    ]


_SECTIONS = {
    "demo": _demo_sections,
    "reconstruct": _reconstruct_sections,
    "evaluate": _evaluate_sections,
    "render": _render_sections,
    "dataset": _dataset_sections,
    "calibrate": _calibrate_sections,
    "prepare": _prepare_sections,
}


def _picture_counts(groups: dict[str, list[View]]) -> list[tuple[str, str, str]]:
    """Numbers of pictures and cameras, picture sizes, rays per pixel."""
    views = [view for group in groups.values() for view in group]
    sizes = {f"{view.width} x {view.height}" for view in views}
    tiles = [
        (name.replace("_", " "), str(len(group)), "picture" if len(group) == 1 else "pictures")
        for name, group in groups.items()
    ]
    names = {view.camera_name for view in views}
    tiles += [("cameras", str(len(names)), ""), ("size", ", ".join(sorted(sizes)), "pixels")]
    samples = sorted({view.samples for view in views if view.samples})
    return tiles + [("rays per pixel", ", ".join(map(str, samples)), "")] * bool(samples)


def _summary(out: Path) -> Section:
    """The most important figures of a run."""
    report, tiles = json_document(out / "report.json"), []
    psnr = reconstruction.training_psnr(out)
    for name, row in list(report.get("effects", {}).items())[:4]:
        if row.get("psnr") is not None:
            tiles.append((name.replace("_", " "), f"{row['psnr']:.2f}", "dB"))
    if psnr is not None and not report:
        tiles.append(("PSNR of training rays", f"{psnr:.2f}", "dB"))
    size = report.get("scene") or json_document(out / "requirement.json").get("after")
    if size:
        kinds = f"{size['moving']:,} moving"
        kinds += f", {size['transient']:,} transient" if size.get("transient") else ""
        tiles.append(("Gaussians", f"{size['gaussians']:,}", kinds))
    file = out / "scene.npz"
    if file.is_file():
        tiles.append(("scene.npz", *file_size(file.stat().st_size)))
    return Section("Summary", [summary_tiles(tiles)] if tiles else [Markup("")])


def _timings(report: dict[str, Any]) -> list[tuple[str, Any]]:
    return [(name, duration(x)) for name, x in report.get("seconds", {}).items() if name != "total"]


def _views(out: Path, capture: Capture | None) -> list[View]:
    """The refined cameras if the run wrote them, else the recorded ones."""
    fitted = read_fitted_cameras(out)
    return fitted.views() if fitted else capture.views if capture else []


def _groups(capture: Capture | None, names: list[str] | None) -> dict[str, list[View]]:
    """The views of each effect, or of the named ones."""
    if capture is None:
        return {}
    groups = capture.by_effect.items()
    return {n: views for n, views in groups if views and (names is None or n in names)}


def _first_of_each(views: list[View]) -> list[View]:
    """One view for each pose of each camera."""
    poses = {
        (v.camera_name, np.asarray(v.camera.trajectory.translation).tobytes()): v for v in views
    }
    return list(poses.values())


def _splits(views: list[View]) -> list[str]:
    return list(dict.fromkeys(view.split for view in views))
