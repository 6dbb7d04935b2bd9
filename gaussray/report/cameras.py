"""Cameras and what they film: a scene beside the pictures it was made from, and films."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from gaussray.camera.camera import Camera
from gaussray.camera.shutter import time_window
from gaussray.capture.formats.paired import Capture, View
from gaussray.capture.frames import read_encoded, read_stored
from gaussray.dataset.images import codes
from gaussray.evaluate.metrics import psnr
from gaussray.render.renderer import Renderer, RenderOptions
from gaussray.report.markup import tag
from gaussray.report.optics import drawn, field_of_view
from gaussray.report.page import Section, note, table
from gaussray.report.picture import BYTES, compared, film, heat_scale
from gaussray.report.plan import plan
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import Clip


SPLITS = {"train": "training cameras", "test": "held-out cameras"}
# Pixels of a picture that a CPU films without letting anybody wait for the page.
PATIENCE = 1 << 19
# Frames of a film, and films.
FRAMES, FILMS = 24, 6


def cameras(views: Sequence[View], scene: Scene | Clip | None, names: dict[str, str]) -> Section:
    """Where the cameras of a capture stand."""
    return Section("Cameras", plan(views, scene, names))


def samples(scene: Scene | Clip, capture: Capture) -> Section | None:
    """Two training and two held-out views of a capture beside what the scene shows there."""
    picked = [one for split in SPLITS for one in _spread(capture.views, split)]
    if not picked:
        return None
    most = max(view.width * view.height for view in picked)
    if jax.default_backend() == "cpu" and most > PATIENCE:
        words = (
            "Pictures of this size take a CPU long: `gaussray evaluate` films and compares them."
        )
        return Section("Truth and ours", [note(words)])
    renderer, figures = Renderer(scene, options=RenderOptions(samples=1)), []
    for view in picked:
        real, ours = _as_codes(read_encoded(view)), codes(renderer(view.camera).color)
        caption = [tag("b", f"{SPLITS[view.split][:-1]} {view.camera_name}"),
                   f" · time {view.time:.4g}, {psnr(real, ours):.2f} dB"]  # fmt: skip
        figures.append(compared(real, ours, caption, most=BYTES // (3 * len(picked))))
    words = "One ray a pixel. `gaussray evaluate` scores every picture."
    return Section(
        "Truth and ours", [heat_scale(), tag("div", figures, class_="grid pairs"), note(words)]
    )


def films(out: Path, groups: Mapping[str, Sequence[View]]) -> Section | None:
    """The pictures of every effect and camera, with a slider through time."""
    shown: dict[str, list[View]] = {}
    for effect, views in groups.items():
        for view in views:
            shown.setdefault(f"{effect} {view.camera_name}", []).append(view)
    chosen = {name: _some(shown[name], FRAMES) for name in list(shown)[:FILMS]}
    count = sum(map(len, chosen.values()))
    figures = [
        film([(f"time {v.time:.4g}", codes_of(v.image, v.width, v.height)) for v in views],
             name.replace("_", " "), most=BYTES // count)
        for name, views in chosen.items()
    ]  # fmt: skip
    left = len(shown) - len(chosen)
    words = f"{left} more are in {out}." if left > 0 else ""
    body: list[Any] = [tag("div", figures, class_="grid few")]
    return Section("Pictures", [*body, note(words) if words else None]) if figures else None


def effects(groups: Mapping[str, Sequence[View]], unit: str) -> Section | None:
    """A camera of every effect: its numbers, and what it does to light."""
    told = {name: views[0] for name, views in groups.items() if views}
    rows = [(name.replace("_", " "), *_facts(view)) for name, view in told.items()]
    heads = (
        "effect",
        "lens",
        "degrees",
        "aperture radius",
        "exposure",
        "readout",
        "rays per pixel",
    )
    body: list[Any] = [table(heads, rows, text=2)]
    figures = [drawn(name.replace("_", " "), view.camera, unit) for name, view in told.items()]
    body.append(tag("div", figures, class_="grid third"))
    words = (
        "Rays are those of the picture's middle row, seen from above; openings are seen from the "
    )
    words += "scene, for the picture's middle and for its corner. "
    words += f"Lengths in scene units, times in the capture's unit ({unit})."
    return Section("The camera", [*body, note(words)]) if rows else None


def _facts(view: View) -> tuple[str, ...]:
    camera: Camera = view.camera
    wide, high = field_of_view(camera)
    exposure = float(camera.shutter.exposure)
    first, last = time_window(camera.shutter, (camera.film.width, camera.film.height))
    radius = float(np.max(camera.aperture.radius))
    figures = [radius, exposure, max(last - first - exposure, 0.0)]
    told = [f"{x:.4g}" if x else "-" for x in figures]
    name = type(camera.lens).__name__
    return name, f"{wide:.4g} x {high:.4g}", *told, "-" if not view.samples else str(view.samples)


def _spread(views: Sequence[View], split: str) -> list[View]:
    """A view of the first and of the last camera of a split, in the middle of their time."""
    own: dict[str, list[View]] = {}
    for view in views:
        if view.split == split:
            own.setdefault(view.camera_name, []).append(view)
    names = list(own)
    names = names if len(names) < 2 else [names[0], names[-1]]
    return [own[name][len(own[name]) // 2] for name in names]


def _some(views: list[View], count: int) -> list[View]:
    place = np.linspace(0, len(views) - 1, min(len(views), count)).round().astype(int)
    return [views[i] for i in place]


def codes_of(path: Path, width: int, height: int) -> np.ndarray:
    """The codes that a screen shows of a picture of this size."""
    stored = read_stored(path, width, height)
    return codes(stored) if path.suffix == ".exr" else _as_codes(stored)


def _as_codes(picture: np.ndarray) -> np.ndarray:
    if picture.dtype == np.uint8:
        return picture
    return np.clip(np.round(picture * 255), 0, 255).astype(np.uint8)
