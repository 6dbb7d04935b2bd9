"""Evaluation: renders the recorded cameras of a capture and scores each effect."""

import dataclasses
import json
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import UInt8

from gaussray.camera.shutter import time_window
from gaussray.capture.capture import Capture, View
from gaussray.capture.picture_file import picture_size, read_levels
from gaussray.capture.spread import evenly_spread
from gaussray.dataset.images import contact_sheet, side_by_side, write_image
from gaussray.dataset.video import write_video
from gaussray.evaluate.flicker import Flicker
from gaussray.evaluate.found_cameras import FoundCapture
from gaussray.evaluate.masks import MotionMasks
from gaussray.evaluate.options import EvaluateOptions
from gaussray.evaluate.perceptual import perceptual_metrics
from gaussray.evaluate.picture_scores import (
    ScoredPicture,
    picture_file_name,
    score_line,
    score_picture,
)
from gaussray.evaluate.remarks import remarks
from gaussray.evaluate.scores import summary
from gaussray.io.atomic import atomic_path, check_files_exist, remove_partial_files, write_json
from gaussray.reconstruct.data.silhouettes import are_silhouettes
from gaussray.render.frame import Frame
from gaussray.render.options import RenderOptions
from gaussray.render.renderer import Renderer
from gaussray.runtime.devices import cores, from_primary, is_primary
from gaussray.runtime.lock import locks_output
from gaussray.runtime.progress import Progress
from gaussray.runtime.provenance import versions
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import Clip, scene_size
from gaussray.tracer.options import TraceOptions


# The scores of every picture, one line each.
SCORES = "scores.jsonl"
# Pictures that are rendered before they are scored, at most, and seconds after which no more are.
_AT_ONCE, _SECONDS = 16, 2.0


@locks_output
def evaluate(
    scene: Scene | Clip,
    truth: Capture | FoundCapture,
    out: Path | str,
    *,
    options: EvaluateOptions | None = None,
    render: RenderOptions | None = None,
    trace: TraceOptions | None = None,
    devices: int | None = None,
    quiet: bool = False,
) -> dict[str, Any]:
    """Render every listed frame with its recorded camera and score it against the picture.

    With several hosts, only host 0 evaluates; the others receive its report.

    Args:
        scene: the reconstructed scene.
        truth: the capture with pictures and recorded cameras, or with what the fit of the scene
            found for them (`with_found_cameras`): renderings then have the exposures that the fit
            learnt.
        out: folder to write: report.json, scores.jsonl with a line per picture, a contact sheet,
            and under <effect>/ each picture beside the truth.
        options: which pictures to score, and rays per pixel; None for the defaults.
        render: options of the renderer, None for the defaults; `options` sets its rays per pixel.
        trace: options of the tracer; None for the defaults.
        devices: how many devices of this host to use; None for all.
        quiet: whether to print no progress.

    Returns:
        The content of report.json. Under `effects`, for each effect: means over the pictures of
        `psnr` (dB) and `ssim`, where pixels that the distortion of a pinhole lens leaves without a
        ray do not count, nor a rim of one pixel around these, nor what the mask of a picture hides,
        which counts in no score; the same inside the field of view of
        any lens, less this rim (`psnr_masked`, `ssim_masked`), and inside the disc that the fisheye
        benchmark scores (`psnr_circle`), where these are not the whole picture (SSIM always without
        the five pixels at the picture's border); PSNR of moving pixels; PSNR after the best gain of
        each picture and channel (`psnr_matched`) where exposures differ; mean opacity where masks
        that cut an object out hide the pictures (`opacity_outside_masks`); `flicker` of static
        pixels beside the capture's own; FLIP and LPIPS if their packages are installed; frames per
        second without compilation; under `parts` the same for training views, held-out cameras and
        held-out times. `remarks` holds sentences that scores do not say by themselves.

    Raises:
        ValueError: If an effect is unknown, or no frame is chosen.
    """
    if not is_primary():
        return _shared_report(None)
    out, options, trace = Path(out), options or EvaluateOptions(), trace or TraceOptions()
    found = truth if isinstance(truth, FoundCapture) else FoundCapture(truth)
    groups = found.capture.by_effect
    chosen = _chosen_views(found.capture.folder, groups, options)
    remove_partial_files(out, deep=True)
    evaluation = _Evaluation(out, found, chosen, options, quiet)
    for effect, views in chosen.items():
        sampling = dataclasses.replace(render or RenderOptions(), samples=options.samples(effect))
        renderer = Renderer(scene, options=sampling, trace=trace, devices=devices)
        evaluation.add_effect(effect, views, groups[effect], renderer)
    return _shared_report(evaluation.write(scene))


def _chosen_views(
    folder: Path, groups: dict[str, list[View]], options: EvaluateOptions
) -> dict[str, list[View]]:
    """The views to score, by effect.

    Raises:
        ValueError: an effect is unknown, or no frame is chosen.
    """
    unknown = [name for name in options.effects if name not in groups]
    if unknown:
        raise ValueError(
            f"evaluate.effects must be among {', '.join(groups)} of {folder}, got {unknown[0]!r}."
        )
    names = options.effects or groups
    chosen = {n: _split_views(views, options) for n, views in groups.items() if n in names}
    chosen = {name: views for name, views in chosen.items() if views}
    if not chosen:
        raise ValueError(
            f"truth={folder} lists no frame of split {options.split!r}. "
            "Choose evaluate.split=all or another folder."
        )
    return chosen


class _Evaluation:
    """Scores pictures, and collects what the report shows."""

    def __init__(
        self,
        out: Path,
        found: FoundCapture,
        chosen: dict[str, list[View]],
        options: EvaluateOptions,
        quiet: bool,
    ):
        self.out, self.options, self.found = out, options, found
        self.silhouettes = _cut_out(found.capture.views)
        self.perceptual = perceptual_metrics()
        parts = [(len(v), _cost(v[0], options.samples(e))) for e, v in chosen.items()]
        total = sum(map(len, chosen.values()))
        self.progress = Progress("evaluate", total, quiet=quiet, parts=parts)
        self.report: dict[str, Any] = {"frames": 0, "effects": {}}
        # Lines of scores.jsonl, rows of the contact sheet, names of the files written.
        self.lines: list[dict[str, Any]] = []
        self.sheet: list[tuple[str, list[np.ndarray]]] = []
        self.written: list[str] = []

    def add_effect(
        self, effect: str, views: list[View], every_view: Sequence[View], renderer: Renderer
    ) -> None:
        """Score the views of an effect; `every_view` of it tells what moves."""
        masks, flicker = MotionMasks(every_view), Flicker()
        rows: list[dict[str, Any]] = []
        films: dict[str, list[Path]] = {}

        def add(view: View, scored: ScoredPicture) -> None:
            row, real, ours = scored.row, scored.real, scored.ours
            rows.append(row)
            self.lines.append(score_line(effect, view, row))
            static = masks.static(view)
            if static is not None:
                flicker.add(row["part"], view.camera_name, static, real, ours, scored.visible)
            if self.options.images:
                file = self._write_image(f"{effect}/{picture_file_name(view)}", scored)
                films.setdefault(view.camera_name, []).append(file)
            if len(rows) == (len(views) + 1) // 2:
                difference = side_by_side(real, ours, scored.shown)[:, -real.shape[1] :]
                self.sheet.append((effect, [real, ours, difference]))
            known = [row["psnr"] for row in rows if "psnr" in row]
            mean = f" {np.mean(known):.2f} dB" if known else ""
            self.progress.report(len(self.lines), f"{effect}{mean}")

        score = partial(
            score_picture,
            masks=masks,
            perceptual=self.perceptual,
            found=self.found,
            silhouettes=self.silhouettes,
        )
        # Pictures are rendered while nothing else runs, for their times are measured; then they are
        # scored side by side.
        with ThreadPoolExecutor(cores(), "evaluate") as threads:
            for batch, frames in _rendered(views, renderer):
                masks.find(batch, threads)
                for view, scored in zip(batch, threads.map(score, batch, frames), strict=True):
                    add(view, scored)
        check_files_exist(self.out, self.written)
        # A picture alone is no film.
        for camera, files in ((name, own) for name, own in films.items() if len(own) > 1):
            self.written.append(f"{effect}/{camera}.mp4")
            write_video(self.out / self.written[-1], map(_truth_and_ours, files), fps=8)
        self.report["effects"][effect] = summary(rows, self.options.samples(effect), flicker)
        self.report["frames"] += len(views)

    def write(self, scene: Scene | Clip) -> dict[str, Any]:
        """Write contact sheet, scores and report, and return the report."""
        check_files_exist(self.out, self.written)
        self.report["scene"] = scene_size(scene)
        self.report["versions"] = versions()
        parts = {line["part"] for line in self.lines}
        self.report["remarks"] = remarks(self.report, parts, self.found)
        write_image(self.out / "contact_sheet.png", contact_sheet(self.sheet, least=256))
        with atomic_path(self.out / SCORES) as partial:
            partial.write_text("".join(json.dumps(line) + "\n" for line in self.lines))
        write_json(self.out / "report.json", self.report)
        return self.report

    def _write_image(self, name: str, scored: ScoredPicture) -> Path:
        self.written.append(name)
        write_image(self.out / name, side_by_side(scored.real, scored.ours, scored.shown))
        return self.out / name


def _cut_out(views: Sequence[View]) -> bool:
    """Whether masks cut an object out of the pictures that a scene is fitted to."""
    fitted = [view for view in views if view.split == "train"] or views
    return len({(view.width, view.height) for view in fitted}) == 1 and are_silhouettes(fitted)


def _rendered(
    views: Sequence[View], renderer: Renderer
) -> Iterator[tuple[list[View], list[Frame]]]:
    """The views and their pictures, as many as are rendered within some seconds."""
    batch: list[View] = []
    frames: list[Frame] = []
    begun = time.monotonic()
    for k, view in enumerate(views, 1):
        batch, frames = [*batch, view], [*frames, renderer(view.camera)]
        if k == len(views) or len(batch) == _AT_ONCE or time.monotonic() - begun > _SECONDS:
            yield batch, frames
            batch, frames, begun = [], [], time.monotonic()


def _truth_and_ours(file: Path) -> UInt8[np.ndarray, "h w2 3"]:
    """Of a picture that was written, the truth and the rendering, without their difference."""
    width, height = picture_size(file)
    return read_levels(file, width, height)[:, : 2 * width // 3]


def _cost(view: View, samples: int) -> float:
    """Estimated time of a picture, in units of a picture with one ray per pixel: one unit for
    scoring, one per ray, and more where rows see the scene at different times."""
    film = view.camera.film
    first, last = time_window(view.camera.shutter, (film.width, film.height))
    many = 10.0 if jax.default_backend() == "cpu" else 1.5
    return 1.0 + samples * (many if last > first else 1.0)


def _shared_report(report: dict[str, Any] | None) -> dict[str, Any]:
    """Host 0's report, on every host."""
    text = np.frombuffer(json.dumps(report).encode(), np.uint8)
    size = int(from_primary(np.array(len(text))))
    text = from_primary(text if is_primary() else np.zeros(size, np.uint8))
    return json.loads(np.asarray(text).tobytes())


def _split_views(views: Sequence[View], options: EvaluateOptions) -> list[View]:
    selected = [v for v in views if options.split in ("all", v.split)]
    return evenly_spread(selected, options.frames) if options.frames else selected
