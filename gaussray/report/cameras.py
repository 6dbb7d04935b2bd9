"""Sections about cameras: where they stand, their numbers, and the pictures they take."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from gaussray.camera.camera import Camera
from gaussray.camera.shutter import time_window
from gaussray.capture.capture import View
from gaussray.capture.frames import read_image
from gaussray.capture.picture_file import read_levels
from gaussray.capture.spread import evenly_spread
from gaussray.dataset.images import srgb_levels
from gaussray.evaluate.exposure import recorded_levels
from gaussray.evaluate.found_cameras import FoundCapture
from gaussray.evaluate.masks import levels_and_mask
from gaussray.evaluate.metrics import psnr
from gaussray.render.options import RenderOptions
from gaussray.render.renderer import Renderer
from gaussray.report.markup import tag
from gaussray.report.optics import camera_drawings, field_of_view, lens_name
from gaussray.report.page import Section, html_table, note
from gaussray.report.picture import BYTES, comparison_figure, error_scale, picture_slider
from gaussray.report.plan import camera_views
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import Clip


SPLITS = {"train": "training cameras", "test": "held-out cameras"}
# Largest picture, in pixels, that a CPU renders for the report.
MAX_CPU_PIXELS = 1 << 19
# Frames per picture sequence, and number of sequences.
_FRAMES, _SEQUENCES = 24, 6


def camera_plan(
    views: Sequence[View], scene: Scene | Clip | None, names: dict[str, str]
) -> Section:
    """The cameras of a capture from above and from the side.

    Args:
        views: pictures with their cameras; those of a split that is not in `names` are left out.
        scene: the scene whose Gaussians are drawn as dots; None draws cameras only.
        names: name of each split in the legend, in the order of the colours.
    """
    return Section("Cameras", camera_views(views, scene, names))


def rendered_samples(scene: Scene | Clip, found: FoundCapture) -> Section | None:
    """Two training and two held-out pictures of a capture beside renderings of the scene, as their
    cameras record it.

    They are the middle pictures in time of the first and of the last camera of each split. Pictures
    too large for a CPU are not rendered; a note says so. None if the capture has no pinhole views.

    Args:
        scene: the scene, which is rendered with one ray per pixel.
        found: the capture, of which only the pinhole views count, with what the fit found for it.
    """
    views = [one for split in SPLITS for one in _spread(found.capture.views, split)]
    if not views:
        return None
    most = max(view.width * view.height for view in views)
    if jax.default_backend() == "cpu" and most > MAX_CPU_PIXELS:
        words = (
            "Pictures of this size take long on a CPU. `gaussray evaluate` renders and scores them."
        )
        return Section("Capture and rendering", [note(words)])
    renderer, figures = Renderer(scene, options=RenderOptions(samples=1)), []
    for view in views:
        truth, shown = levels_and_mask(view)
        image = recorded_levels(renderer(view.camera).color, found.response(view))
        # A picture that its mask hides has no score.
        score = f", {psnr(truth, image, shown):.2f} dB" if shown is None or shown.any() else ""
        caption = [tag("b", f"{SPLITS[view.split][:-1]} {view.camera_name}"),
                   f" · time {view.time:.4g}{score}"]  # fmt: skip
        most = BYTES // (3 * len(views))
        figures.append(comparison_figure(truth, image, caption, shown=shown, most=most))
    words = "One ray per pixel. `gaussray evaluate` scores every picture."
    return Section(
        "Capture and rendering",
        [error_scale(), tag("div", figures, class_="grid pairs"), note(words)],
    )


def picture_sequences(out: Path, groups: Mapping[str, Sequence[View]]) -> Section | None:
    """The pictures of each effect and camera, with a time slider; None without pictures.

    Args:
        out: the run's folder, which a note names if there are more sequences than are shown.
        groups: the views of each effect, in the order of time; their pictures are read.
    """
    sequences: dict[str, list[View]] = {}
    for effect, views in groups.items():
        for view in views:
            sequences.setdefault(f"{effect} {view.camera_name}", []).append(view)
    chosen = {
        name: evenly_spread(sequences[name], _FRAMES) for name in list(sequences)[:_SEQUENCES]
    }
    count = sum(map(len, chosen.values()))
    figures = [
        picture_slider(
            [(f"time {v.time:.4g}", screen_levels(v.image, v.width, v.height)) for v in views],
            name.replace("_", " "),
            most=BYTES // count,
        )
        for name, views in chosen.items()
    ]
    left = len(sequences) - len(chosen)
    words = f"{left} more sequences are in {out}." if left > 0 else ""
    body: list[Any] = [tag("div", figures, class_="grid few")]
    return Section("Pictures", [*body, note(words) if words else None]) if figures else None


def camera_table(groups: Mapping[str, Sequence[View]], unit: str) -> Section | None:
    """One camera per effect: its numbers, and drawings of rays, aperture and shutter.

    None without views.

    Args:
        groups: the views of each effect, of which the first is shown.
        unit: name of the capture's unit of time.
    """
    first = {name: views[0] for name, views in groups.items() if views}
    rows = [(name.replace("_", " "), *_camera_row(view)) for name, view in first.items()]
    heads = (
        "effect",
        "lens",
        "field of view (°)",
        "aperture radius (scene units)",
        f"exposure ({unit})",
        f"readout ({unit})",
        "rays per pixel",
    )
    body: list[Any] = [html_table(heads, rows, text=2)]
    figures = [
        camera_drawings(name.replace("_", " "), view.camera, unit) for name, view in first.items()
    ]
    body.append(tag("div", figures, class_="grid third"))
    words = (
        "Rays: those of the picture's middle row, seen from above. Aperture: seen from the scene, "
        "for the picture's middle and its corner. Lengths are in scene units, times in the "
        f"capture's unit ({unit})."
    )
    return Section("The camera", [*body, note(words)]) if rows else None


def _camera_row(view: View) -> tuple[str, ...]:
    camera: Camera = view.camera
    wide, high = field_of_view(camera)
    exposure = float(camera.shutter.exposure)
    first, last = time_window(camera.shutter, (camera.film.width, camera.film.height))
    radius = float(np.asarray(camera.aperture.radius).max())
    figures = [radius, exposure, max(last - first - exposure, 0.0)]
    cells = [f"{x:.4g}" if x else "-" for x in figures]
    name = lens_name(camera.lens)
    return name, f"{wide:.4g} x {high:.4g}", *cells, "-" if not view.samples else str(view.samples)


def _spread(views: Sequence[View], split: str) -> list[View]:
    """The middle view in time of the first and of the last camera of a split."""
    by_camera: dict[str, list[View]] = {}
    for view in views:
        if view.split == split:
            by_camera.setdefault(view.camera_name, []).append(view)
    names = list(by_camera)
    names = names if len(names) < 2 else [names[0], names[-1]]
    return [by_camera[name][len(by_camera[name]) // 2] for name in names]


def screen_levels(path: Path, width: int, height: int) -> np.ndarray:
    """8-bit sRGB levels [h, w, 3] of a picture file; EXR is encoded to sRGB.

    Args:
        path: the file, or a frame of a video (`videos.frame_path`).
        width: columns that the file must have.
        height: rows that the file must have.
    """
    if path.suffix.lower() == ".exr":
        return srgb_levels(read_image(path, width, height))
    return read_levels(path, width, height)
