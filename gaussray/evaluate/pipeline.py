"""Evaluation: renders the recorded cameras of a capture and scores each effect."""

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool

from gaussray.camera.camera import Camera
from gaussray.camera.film import pixel_grid
from gaussray.camera.shutter import time_window
from gaussray.capture.capture import Capture, View, viewpoints
from gaussray.capture.frames import read_encoded
from gaussray.capture.temporal_median import moving_mask
from gaussray.dataset.images import codes, contact_sheet, side_by_side, write_image
from gaussray.dataset.video import write_video
from gaussray.evaluate.flicker import Flicker
from gaussray.evaluate.metrics import psnr, ssim, unit_values
from gaussray.evaluate.perceptual import perceptual_metrics
from gaussray.evaluate.scores import summary
from gaussray.io.atomic import demand, sweep, whole, write_json
from gaussray.render.renderer import Renderer, RenderOptions
from gaussray.runtime.devices import agreed, leads
from gaussray.runtime.lock import locks_output
from gaussray.runtime.progress import Progress
from gaussray.runtime.provenance import versions
from gaussray.scene.scene import Scene, transient_count
from gaussray.scene.segmented import Clip, segments_of
from gaussray.tracer.trace import TraceOptions


# A line per scored picture.
SCORES = "scores.jsonl"


class EvaluateOptions(eqx.Module):
    """Which pictures are scored, and with how many rays per pixel.

    Args:
        split: `train`, `test` or `all`.
        effects: Names of the effects to score. Empty: all.
        frames: The largest number of pictures per effect, evenly spread. 0: all.
        pinhole: Rays per pixel of the effect `pinhole`.
        rolling_shutter: Rays per pixel of the effect `rolling_shutter`.
        fisheye: Rays per pixel of the effect `fisheye`.
        depth_of_field: Rays per pixel of the effect `depth_of_field`.
        other: Rays per pixel of any other effect.
        images: Whether to write truth, rendering and difference side by side, and videos.

    Raises:
        ValueError: If an option is out of range. The message names its key.
    """

    split: str = eqx.field(static=True, default="test")
    effects: tuple[str, ...] = eqx.field(static=True, default=())
    frames: int = eqx.field(static=True, default=0)
    pinhole: int = eqx.field(static=True, default=1)
    rolling_shutter: int = eqx.field(static=True, default=1)
    fisheye: int = eqx.field(static=True, default=4)
    depth_of_field: int = eqx.field(static=True, default=16)
    other: int = eqx.field(static=True, default=16)
    images: bool = eqx.field(static=True, default=True)

    def __check_init__(self):
        if self.split not in ("train", "test", "all"):
            raise ValueError(f"evaluate.split must be train, test or all, got {self.split!r}.")
        for name in ("pinhole", "rolling_shutter", "fisheye", "depth_of_field", "other"):
            if getattr(self, name) < 1:
                raise ValueError(f"evaluate.{name} must be at least 1, got {getattr(self, name)}.")
        if self.frames < 0:
            raise ValueError(f"evaluate.frames must be at least 0, got {self.frames}.")

    def samples(self, effect: str) -> int:
        """Rays per pixel of an effect."""
        known = ("pinhole", "rolling_shutter", "fisheye", "depth_of_field")
        return getattr(self, effect if effect in known else "other")


@locks_output
def evaluate(
    scene: Scene | Clip,
    truth: Capture,
    out: Path | str,
    *,
    options: EvaluateOptions,
    render: RenderOptions,
    trace: TraceOptions,
    devices: int | None = None,
    quiet: bool = False,
) -> dict[str, Any]:
    """Render every listed frame with its recorded camera and score it against the picture.

    With several hosts, only host 0 evaluates; the others receive its report.

    Args:
        scene: The reconstructed scene.
        truth: The capture with pictures and recorded cameras.
        out: Folder to write: report.json, scores.jsonl with a line per picture, a contact sheet,
            and under <effect>/ each picture beside the truth.
        options: Which pictures to score, and rays per pixel.
        render: Options of the renderer; `options` sets its rays per pixel.
        trace: Options of the tracer.
        devices: How many devices of this host to use; None for all.
        quiet: Whether to print no progress.

    Returns:
        The content of report.json. Under `effects`, for each effect: means over the pictures of
        `psnr` (dB) and `ssim`; the same inside the lens's field of view (`masked`) and inside the
        disc that the fisheye benchmark scores (`circle`), where these are not the whole picture;
        PSNR of moving pixels; `flicker` of static pixels beside the capture's own; FLIP and LPIPS
        if their packages are installed; frames per second without compilation; under `parts` the
        same for training views, held-out cameras and held-out times.

    Raises:
        ValueError: If an effect is unknown, or no frame is chosen.
    """
    if not leads():
        return _shared_report(None)
    out = Path(out)
    groups = {"pinhole": truth.views, **truth.effects}
    unknown = [name for name in options.effects if name not in groups]
    if unknown:
        raise ValueError(
            f"evaluate.effects must be among {', '.join(groups)} of {truth.folder}, "
            f"got {unknown[0]!r}."
        )
    groups = {name: views for name, views in groups.items() if name in (options.effects or groups)}
    chosen = {name: _split_views(views, options) for name, views in groups.items()}
    chosen = {name: views for name, views in chosen.items() if views}
    if not chosen:
        raise ValueError(
            f"truth={truth.folder} lists no frame of split {options.split!r}. "
            "Choose evaluate.split=all or another folder."
        )
    sweep(out, deep=True)
    parts = [(len(views), _cost(views[0], options.samples(e))) for e, views in chosen.items()]
    progress = Progress("evaluate", sum(map(len, chosen.values())), quiet=quiet, parts=parts)
    report: dict[str, Any] = {"frames": 0, "effects": {}}
    trained = {view.camera_name for view in truth.views if view.split == "train"}
    perceptual = perceptual_metrics()
    sheet, done, lines, written = [], 0, [], list[str]()
    for effect, views in chosen.items():
        samples = options.samples(effect)
        sampling = dataclasses.replace(render, samples=samples)
        renderer = Renderer(scene, options=sampling, trace=trace, devices=devices)
        moving = _moving(groups[effect])
        static, flicker = _static(groups[effect], moving), Flicker()
        rows, films = [], {}
        for view in views:
            frame = renderer(view.camera)
            ours, real = codes(frame.color), _levels(view)
            visible = _visible(view.camera)
            rows.append(_score(real, ours, visible, moving.get(view.image)))
            rows[-1] |= {name: measure(real, ours) for name, measure in perceptual.items()}
            rows[-1]["seconds"] = None if frame.compiled else frame.seconds
            rows[-1]["part"] = _part(view, trained)
            lines.append(_line(effect, view, rows[-1]))
            if view.camera_name in static:
                mask = static[view.camera_name] & (True if visible is None else visible)
                flicker.add(rows[-1]["part"], view.camera_name, mask, real, ours)
            if options.images:
                written.append(f"{effect}/{_file(view)}")
                write_image(out / written[-1], side_by_side(real, ours))
                films.setdefault(view.camera_name, []).append(np.hstack([real, ours]))
            if len(rows) == (len(views) + 1) // 2:
                sheet.append((effect, [real, ours, side_by_side(real, ours)[:, -real.shape[1] :]]))
            done += 1
            progress.report(done, f"{effect} {np.mean([r['psnr'] for r in rows]):.2f} dB")
        for camera, film in films.items():
            written.append(f"{effect}/{camera}.mp4")
            write_video(out / written[-1], film, fps=8)
        report["effects"][effect] = summary(rows, samples, flicker)
        report["frames"] += len(views)
    demand(out, written)
    report["scene"] = scene_size(scene)
    report["versions"] = versions()
    write_image(out / "contact_sheet.png", contact_sheet(sheet, least=256))
    with whole(out / SCORES) as partial:
        partial.write_text("".join(json.dumps(line) + "\n" for line in lines))
    write_json(out / "report.json", report)
    return _shared_report(report)


def _cost(view: View, samples: int) -> float:
    """Estimated time of a picture, in units of a picture with one ray per pixel: one unit for
    scoring, one per ray, and more where rows see the scene at different times."""
    film = view.camera.film
    first, last = time_window(view.camera.shutter, (film.width, film.height))
    many = 10.0 if jax.default_backend() == "cpu" else 1.5
    return 1.0 + samples * (many if last > first else 1.0)


def _line(effect: str, view: View, row: dict[str, Any]) -> dict[str, Any]:
    """The line of a picture in scores.jsonl; `file` is its truth | rendering | difference."""
    named = {"effect": effect, "camera": view.camera_name, "time": view.time, "part": row["part"]}
    file = f"{effect}/{_file(view)}"
    figures = {name: x for name, x in row.items() if isinstance(x, float)}
    # Equal pictures have an infinite PSNR, which JSON cannot represent.
    figures = {name: x if np.isfinite(x) else None for name, x in figures.items()}
    return named | {"file": file} | figures


def _file(view: View) -> str:
    return f"{view.camera_name}_{view.time:.4f}.png"


def _shared_report(report: dict[str, Any] | None) -> dict[str, Any]:
    """Host 0's report, on every host."""
    text = np.frombuffer(json.dumps(report).encode(), np.uint8)
    size = int(agreed(np.array(len(text))))
    text = agreed(text if leads() else np.zeros(size, np.uint8))
    return json.loads(np.asarray(text).tobytes())


def _split_views(views: Sequence[View], options: EvaluateOptions) -> list[View]:
    picked = [v for v in views if options.split in ("all", v.split)]
    if options.frames and len(picked) > options.frames:
        place = np.linspace(0, len(picked) - 1, options.frames).round().astype(int)
        picked = [picked[i] for i in place]
    return picked


def _levels(view: View) -> np.ndarray:
    picture = read_encoded(view)
    if picture.dtype == np.uint8:
        return picture
    return np.clip(np.round(picture * 255), 0, 255).astype(np.uint8)


def _visible(camera: Camera) -> Bool[np.ndarray, "h w"] | None:
    """Pixels inside the lens's field of view, less one at the rim; None if that is all."""
    grid = pixel_grid(camera.film)
    flat = grid.reshape(-1, 2).astype(camera.time.dtype) + 0.5
    seen = np.asarray(_sees(camera, flat)).reshape(grid.shape[:2])
    if seen.all():
        return None
    padded = np.pad(seen, 1, constant_values=True)
    inner = seen.copy()
    for dy in range(3):
        for dx in range(3):
            inner &= padded[dy : dy + seen.shape[0], dx : dx + seen.shape[1]]
    return inner


@eqx.filter_jit
def _sees(camera: Camera, pixel: Array) -> Array:
    return jax.vmap(camera.lens.sees)(pixel)


def _circle(shape: tuple[int, ...]) -> Bool[np.ndarray, "h w"]:
    """The centred disc in which the fisheye benchmark scores: 409.6 of 512 pixels across."""
    y, x = (np.arange(n) + 0.5 - n / 2 for n in shape)
    return np.hypot(x, y[:, None]) < 0.4 * min(shape)


def _moving(views: Sequence[View]) -> dict[Path, Bool[np.ndarray, "h w"]]:
    """Mask of what moves in each picture, from all pictures of the same viewpoint.

    The pictures of a camera that moves have no common viewpoint, and no mask.
    """
    groups: dict[int, list[View]] = {}
    for number, view in zip(viewpoints(views), views, strict=True):
        groups.setdefault(number, []).append(view)
    masks = {}
    for group in groups.values():
        if len(group) > 1:
            frames = unit_values(np.stack([_levels(view) for view in group]), np.float32)
            masks |= dict(zip([v.image for v in group], moving_mask(frames), strict=True))
    return masks


def _static(
    views: Sequence[View], moving: dict[Path, Bool[np.ndarray, "h w"]]
) -> dict[str, Bool[np.ndarray, "h w"]]:
    """Pixels in which nothing ever moves, for each camera that stands still and has several
    pictures."""
    static: dict[str, Bool[np.ndarray, "h w"]] = {}
    places: dict[str, set[int]] = {}
    for number, view in zip(viewpoints(views), views, strict=True):
        places.setdefault(view.camera_name, set()).add(number)
    for view in views:
        if view.image in moving and len(places[view.camera_name]) == 1:
            mask = ~moving[view.image]
            static[view.camera_name] = static.get(view.camera_name, mask) & mask
    return static


def _score(real: np.ndarray, ours: np.ndarray, visible, moving) -> dict[str, Any]:
    score: dict[str, Any] = {"psnr": psnr(real, ours), "ssim": ssim(real, ours)}
    if visible is not None:
        for name, mask in (("masked", visible), ("circle", _circle(visible.shape))):
            score[f"psnr_{name}"] = psnr(real, ours, mask)
            score[f"ssim_{name}"] = ssim(real, ours, mask)
    if moving is not None and moving.any():
        error = (real.astype(np.float64) - ours)[moving] / 255
        score["moving"] = (float(np.sum(error**2)), error.size)
    return score


def _part(view: View, trained: set[str]) -> str:
    if view.split == "train":
        return "train"
    return "held_out_times" if view.camera_name in trained else "held_out_cameras"


def scene_size(scene: Scene | Clip) -> dict[str, int]:
    """Number of Gaussians, of moving ones, and bytes of a scene, over all segments."""
    size = sum(x.size * x.dtype.itemsize for x in jax.tree.leaves(scene))
    parts = segments_of(scene)
    moving = sum(part.moving.count for part in parts)
    total, transient = sum(part.count for part in parts), sum(transient_count(x) for x in parts)
    facts = {"gaussians": total, "moving": moving, "bytes": int(size)}
    if transient:
        facts["transient"] = transient
    return facts | {"segments": len(parts)} if isinstance(scene, Clip) else facts
