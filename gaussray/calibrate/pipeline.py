"""Calibration: camera parameters estimated from pictures of a known scene."""

import time as clock
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gaussray.calibrate.observations import check_views, read_observation, selected_views
from gaussray.calibrate.options import CalibrateOptions
from gaussray.calibrate.parameters import Unknown, prepare_lens, unit_camera_set, unknowns
from gaussray.calibrate.residuals import ResidualEvaluator
from gaussray.calibrate.results import (
    calibrated_records,
    check_effect,
    confounded_pairs,
    parameter_rows,
    residual_psnr,
    unknown_labels,
)
from gaussray.calibrate.solver import CameraSolver, Observation, Solution, block_sides
from gaussray.camera.array import rays_per_pixel
from gaussray.capture.capture import Capture
from gaussray.capture.formats.transforms import effect_file
from gaussray.capture.view_file import check_images
from gaussray.dataset.manifest import write_manifest
from gaussray.io.atomic import write_json
from gaussray.runtime.devices import is_primary
from gaussray.runtime.progress import Progress
from gaussray.runtime.provenance import versions
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import Clip
from gaussray.tracer.options import TraceOptions


def calibrate(
    scene: Scene | Clip,
    capture: Capture,
    out: Path | str,
    *,
    options: CalibrateOptions | None = None,
    trace: TraceOptions | None = None,
    quiet: bool = False,
) -> dict[str, Any]:
    """Estimate camera parameters by comparing pictures with renderings of a known scene.

    Robust photometric least squares, from coarse to fine pictures. The scene does not change. An
    independent standard error is the scatter of a value if errors are independent from pixel to
    pixel; a tile standard error assumes that errors are equal within tiles of 8 x 8 pixels.
    Systematic errors of the scene can shift values beyond both.

    Args:
        scene: the scene that the pictures show.
        capture: pictures with recorded cameras, the starting guess.
        out: folder to write. It receives a manifest with the calibrated cameras (transforms.json,
            or <effect>.json), which `render` and `evaluate` read, and report.json.
        options: which parameters to estimate, and from which pictures; None for the defaults.
        trace: options of the tracer; None for the defaults.
        quiet: whether to print no progress.

    Returns:
        The content of report.json: under `parameters` the `name`, `camera`, `start`, `value`,
        `unit` and `standard_error` (`independent`, `tiles`) of every estimated number; under
        `confounded` a sentence for every two numbers that the pictures can hardly tell apart; under
        `psnr` the PSNR in dB of the compared pixels `before` and `after`, with exposure gains.

    Raises:
        ValueError: If the options choose no picture; if a parameter has no effect on the pictures;
            if a picture shows two segments of the scene; if the cameras do not share their lens; if
            the estimated coefficients make no valid lens.
    """
    start, options = clock.monotonic(), options or CalibrateOptions()
    effect, views = selected_views(capture, options)
    lens = prepare_lens(views[0].camera.lens, options.coefficients)
    parameters = unknowns(options.parameters, lens, options.coefficients, capture.time_unit)
    check_views(views, parameters)
    check_images(views)

    cameras = list(dict.fromkeys(view.camera_name for view in views))
    observations = [
        read_observation(scene, view, lens, cameras.index(view.camera_name)) for view in views
    ]
    solver = _solver(observations, parameters, options, trace or TraceOptions())
    labelled, levels = unknown_labels(solver, cameras), block_sides(observations, options.coarsest)
    check_effect(solver.recorded_sums(levels[0]), labelled)

    progress = Progress("calibrate", len(levels), quiet=quiet)
    solution = solver.solve(
        levels,
        steps=options.steps,
        report=lambda f, i, s: progress.report(levels.index(f), f"1/{f}, step {i}: {255 * s:.2f}"),
    )
    report = {
        "effect": effect,
        "cameras": cameras,
        "pictures": len(views),
        "parameters": parameter_rows(solver, solution, labelled),
        "confounded": confounded_pairs(solution, labelled),
        **_quality(solution),
        "seconds": round(clock.monotonic() - start, 1),
        "versions": versions(),
    }
    if is_primary():
        pinhole = effect == "pinhole" and bool(capture.views)
        every_view = capture.views if pinhole else capture.effects[effect]
        records = calibrated_records(solver, solution, every_view, effect, cameras)
        out = Path(out)
        out.mkdir(parents=True, exist_ok=True)
        write_manifest(out / effect_file(effect), records, extra={"time_unit": capture.time_unit})
        write_json(out / "report.json", report)
    return report


def _solver(
    observations: Sequence[Observation],
    parameters: tuple[Unknown, ...],
    options: CalibrateOptions,
    trace: TraceOptions,
) -> CameraSolver:
    """The solver, which renders as many rays a pixel as the effects of the pictures need."""
    samples = options.samples or max(
        rays_per_pixel(observation.camera) for observation in observations
    )
    residuals = ResidualEvaluator(samples=samples, trace=trace, bend=options.huber_threshold)
    cameras = unit_camera_set(observations[0].camera)
    return CameraSolver(observations, parameters, cameras, residuals)


def _quality(solution: Solution) -> dict[str, Any]:
    """PSNR before and after, and the steps and the deviation (8-bit levels) of each level."""
    return {
        "psnr": {"before": residual_psnr(solution.before), "after": residual_psnr(solution.after)},
        "levels": [
            {"pixels": f, "steps": n, "deviation": round(255 * s, 4)} for f, n, s in solution.levels
        ],
    }
