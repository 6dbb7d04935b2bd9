"""All labels of one frame of a trained scene, on one sheet.

python -m experiments.labels.show SCENE OUT.png [--camera cam13] [--frame 6]
"""

import argparse
import dataclasses
import time as clock
from pathlib import Path

import numpy as np

from gaussray.camera.aperture import Aperture
from gaussray.camera.camera import Camera
from gaussray.camera.ideal_pinhole import ideal_pinhole_of
from gaussray.camera.shutter import Shutter
from gaussray.dataset.images import contact_sheet, write_image
from gaussray.render import Renderer, RenderOptions
from gaussray.render.aov.labeller import LABELS, Labeller
from gaussray.render.rig.view_files import load_views
from gaussray.scene.store import load_scene
from gaussray.tracer.options import TraceOptions


# Motion of so many pixels has full colour.
FULL = 12.0


def filmed(camera: Camera, interval: float) -> Camera:
    """The camera with an aperture, a readout of a frame's interval and half of it of exposure."""
    radius, focus, zero, one = (np.float32(x) for x in (0.06, 3.0, 0.0, 1.0))
    step = np.float32(interval / camera.film.height)
    shutter = Shutter(np.float32(-interval / 2), step, np.float32(interval / 2))
    return dataclasses.replace(camera, aperture=Aperture(radius, focus, zero, one), shutter=shutter)


def shown(name: str, label: np.ndarray) -> np.ndarray:
    """A label as light in 0..1: NaN is black, one number a grey from its least to its largest."""
    label = np.asarray(label, np.float64)
    if name.startswith("flow"):
        return wheel(label)
    if name in ("normal", "direction"):
        return np.nan_to_num(label / 2 + 0.5)
    if name in ("group", "gaussian"):
        random = np.random.default_rng(1).uniform(0.1, 1, (int(label.max()) + 2, 3))
        random[0] = 0
        return random[label.astype(int) + (name == "gaussian")]
    low, high = np.nanmin(label), np.nanmax(label)
    grey = np.nan_to_num((label - low) / max(high - low, 1e-9))
    return grey if grey.ndim == 3 else np.repeat(grey[..., None], 3, axis=-1)


def wheel(flow: np.ndarray) -> np.ndarray:
    """Motion as colour: its direction is the hue, white is none, black is unknown."""
    angle = np.arctan2(flow[..., 1], flow[..., 0])
    size = np.clip(np.hypot(flow[..., 0], flow[..., 1]) / FULL, 0, 1)[..., None]
    hue = 0.5 + 0.5 * np.cos(angle[..., None] - np.array([0, 2, 4]) * np.pi / 3)
    return np.nan_to_num(1 - size + size * hue)


def main(scene: str, out: Path, camera: str, frame: int) -> None:
    """Write the sheet, and print what the labels cost."""
    views = [view for view in load_views(scene, None) if view.camera_name == camera]
    near = views[frame - 1 : frame + 2]
    before, now, after = (filmed(v.camera, near[1].time - near[0].time) for v in near)
    loaded = load_scene(scene)
    render = Renderer(loaded, options=RenderOptions(samples=16))
    labeller = Labeller(loaded, options=RenderOptions(), trace=TraceOptions())
    names = [name for name in LABELS if name != "sharp"]
    for _ in range(2):
        began = clock.monotonic()
        found = labeller(now, names, before=before, after=after)
    seconds = clock.monotonic() - began
    pictures = {"picture": render(now).color, "sharp": render(ideal_pinhole_of(now)).color}
    pictures |= {name: shown(name, found[name]) for name in names}
    listed = list(pictures.items())
    rows = [listed[i : i + 6] for i in range(0, len(listed), 6)]
    sheets = [
        contact_sheet([("", [x for _, x in row])], titles=[n for n, _ in row]) for row in rows
    ]
    widest = max(sheet.shape[1] for sheet in sheets)
    padded = [
        np.pad(s, ((0, 0), (0, widest - s.shape[1]), (0, 0)), constant_values=255) for s in sheets
    ]
    write_image(out, np.concatenate(padded))
    size = now.film
    print(f"{out}: {camera}, frame {frame}, {size.width} x {size.height}")
    print(f"all labels together: {seconds:.2f} s a frame, compilation left out")
    for name in ("flow_forward", "blur", "confusion"):
        print(f"{name}: up to {np.nanmax(np.abs(found[name])):.2f} pixels")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene")
    parser.add_argument("out", type=Path)
    parser.add_argument("--camera", default="cam13")
    parser.add_argument("--frame", type=int, default=6)
    main(**vars(parser.parse_args()))
