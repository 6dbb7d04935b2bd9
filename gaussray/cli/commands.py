"""The commands: each builds typed options from its configuration and calls the library."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from gaussray.cli.reconstruct import run_demo, run_reconstruct
from gaussray.cli.result import say_result, write_report
from gaussray.cli.selected_capture import selected_capture
from gaussray.config.compose import Configuration
from gaussray.config.options import as_type, build_options
from gaussray.config.run_folder import begin_run_folder
from gaussray.io.validate import changed_fields
from gaussray.runtime.devices import DevicesOptions, start_devices
from gaussray.runtime.lock import lock_output
from gaussray.runtime.output import counted
from gaussray.runtime.progress import say


def _render(cfg: Configuration, devices: int | None) -> dict[str, Any]:
    from gaussray.config.jobs import render_job
    from gaussray.render.dataset import render_dataset

    _refuse_dataset_keys(cfg)
    job = render_job(cfg, note=say)
    out = Path(cfg.out)
    # For all of the command, as its report is written as well.
    lock_output(out)
    # The record of what is there stays if it is something else.
    render_dataset(
        job.renderer(devices),
        job.records,
        out,
        options=job.dataset,
        quiet=cfg.quiet,
        on_start=lambda: begin_run_folder(cfg),
    )
    effect, count = job.records[0].effect, len(job.records)
    text = f"{out}: {count} {'picture' if count == 1 else 'pictures'} ({effect.replace('_', ' ')})."
    text += f" Open {out / 'report.html'} in a browser." if cfg.report else ""
    say_result(text, out=str(out), frames=count, effect=effect)
    return {"scene": job.scene}


def _refuse_dataset_keys(cfg: Configuration) -> None:
    """Refuse keys that only a dataset of drawn samples uses, as dataset.count is 0."""
    from gaussray.camera.imu import ImuOptions
    from gaussray.render.randomize.options import DrawOptions

    needy = [f"dataset.{key}" for key in changed_fields(build_options(DrawOptions, cfg.dataset))]
    needy += ["sample"] if cfg.sample else []
    needy += [f"imu.{key}" for key in changed_fields(build_options(ImuOptions, cfg.imu))]
    if needy:
        raise ValueError(f"{needy[0]} needs dataset.count of at least 1, got 0.")


def generate(cfg: Configuration, overrides: Sequence[str]) -> None:
    """Render a data set: samples of the configuration's distributions (dataset.count).

    Args:
        cfg: configuration of `gaussray render`.
        overrides: words of the command line, KEY=VALUE. Each sample adds its drawn values to them.
    """
    from gaussray.camera.imu import ImuOptions
    from gaussray.config.samples import generate_dataset
    from gaussray.dataset.layouts import check_imu_keys
    from gaussray.dataset.sample_manifest import MANIFEST

    check_imu_keys(build_options(ImuOptions, cfg.imu), cfg.dataset.layout, "dataset.layout")
    result, out = generate_dataset(cfg, overrides), Path(str(cfg.out))
    if cfg.report and (out / MANIFEST).is_file():
        write_report("dataset", out, {})
    say(result, "result", verb="render", out=cfg.out)


def view(cfg: Configuration, overrides: Sequence[str]) -> None:
    """Serve the viewer until the user stops it.

    Args:
        cfg: configuration of the command.
        overrides: words of the command line, KEY=VALUE. Configurations that the page composes
            with the values of its controls begin with them.
    """
    from gaussray.viewer.serve import serve

    start_devices(build_options(DevicesOptions, cfg.devices))
    server = serve(cfg, overrides)
    say_result(
        f"{server.url} shows {cfg.scene}. The first pictures take longer, until their programs are "
        "compiled. Stop with Ctrl-C.",
        url=server.url,
    )
    server.wait()


def _evaluate(cfg: Configuration, devices: int | None) -> dict[str, Any]:
    from gaussray.evaluate.found_cameras import with_found_cameras
    from gaussray.evaluate.options import EvaluateOptions
    from gaussray.evaluate.pipeline import evaluate
    from gaussray.evaluate.scores import scores_text
    from gaussray.render.options import RenderOptions
    from gaussray.scene.formats.any_file import load
    from gaussray.tracer.options import TraceOptions

    chosen, trace = (
        build_options(EvaluateOptions, cfg.evaluate),
        build_options(TraceOptions, cfg.trace),
    )
    render = build_options(RenderOptions, cfg.render)
    scene, truth = load(cfg.scene), selected_capture(cfg.truth, cfg, "truth_", "truth_")
    found = with_found_cameras(truth, Path(cfg.scene))
    if cfg.out == f"{cfg.scene}/evaluation" and Path(cfg.scene).is_file():
        # Several scenes may be files of one folder; that of a run has its evaluation there.
        file = Path(cfg.scene)
        own = "" if file.name == "scene.npz" else f"{file.stem}_"
        cfg.out = str(file.parent / f"{own}evaluation")
    out = begin_run_folder(cfg)
    report = evaluate(
        scene,
        found,
        out,
        options=chosen,
        render=render,
        trace=trace,
        devices=devices,
        quiet=cfg.quiet,
    )
    say_result(scores_text(report), out=str(out), report=report)
    return {"scene": scene, "capture": found.capture}


def _calibrate(cfg: Configuration, devices: int | None) -> dict[str, Any]:
    from gaussray.calibrate.options import CalibrateOptions
    from gaussray.calibrate.pipeline import calibrate
    from gaussray.calibrate.results import calibration_table
    from gaussray.scene.formats.any_file import load
    from gaussray.tracer.options import TraceOptions

    chosen, trace = (
        build_options(CalibrateOptions, cfg.calibrate),
        build_options(TraceOptions, cfg.trace),
    )
    scene, capture = load(cfg.scene), selected_capture(cfg.capture.path, cfg.capture, "capture.")
    out = begin_run_folder(cfg)
    report = calibrate(scene, capture, out, options=chosen, trace=trace, quiet=cfg.quiet)
    say_result(calibration_table(report), out=str(out), report=report)
    return {"scene": scene, "capture": capture}


def _prepare(cfg: Configuration, devices: int | None) -> None:
    from gaussray.prepare import options, prepare_capture
    from gaussray.prepare.errors import PrepareError
    from gaussray.prepare.findings.finding import Finding, doubts_text
    from gaussray.prepare.pipeline import FACTS_FILE
    from gaussray.report import write_page

    chosen = options.PrepareOptions(
        build_options(options.SyncOptions, cfg.sync),
        build_options(options.FramesOptions, cfg.frames),
        build_options(options.PosesOptions, cfg.poses),
    )
    out = begin_run_folder(cfg)
    (out / FACTS_FILE).unlink(missing_ok=True)
    try:
        facts = prepare_capture(cfg.videos, out, options=chosen)
    except PrepareError as error:
        # The pictures show why; without facts the input was refused before any were looked at.
        if cfg.report and (out / FACTS_FILE).is_file():
            raise PrepareError(f"{error} See {write_page('prepare', out)}.") from None
        raise
    times = facts["timestamps"]
    pictures = f"{counted(len(facts['cameras']), 'camera')}, {counted(times, 'timestamp')}"
    if not facts["rate"]:
        pictures = f"{times} photographs"
    lines = [f"{out}: {pictures}, {facts['points']} points."]
    if doubts := doubts_text(Finding(**finding) for finding in facts["findings"]):
        lines += [doubts, f"See {out / 'report.html'}."] if cfg.report else [doubts]
    text = "\n".join([*lines, f"Next: gaussray reconstruct capture.path={out}"])
    say_result(text, out=str(out), findings=facts["findings"])


def _import(cfg: Configuration, devices: int | None) -> None:
    from gaussray.scene.formats.convert import import_model

    color = as_type(str, cfg.color, "color")
    iteration = None if cfg.iteration is None else as_type(int, cfg.iteration, "iteration")
    scene, assumed = import_model(cfg.source, cfg.out, color=color, iteration=iteration)
    out = begin_run_folder(cfg)
    say_result(f"{out / 'scene.npz'}: {scene.count} Gaussians.\n{assumed}")


def _export(cfg: Configuration, devices: int | None) -> None:
    from gaussray.scene.formats.any_file import export_format, load
    from gaussray.scene.formats.convert import export_model
    from gaussray.scene.formats.export_transients import export_transients
    from gaussray.scene.formats.sequence import export_sequence

    time = None if cfg.time is None else as_type(float, cfg.time, "time")
    color, degree = as_type(str, cfg.color, "color"), as_type(int, cfg.degree, "degree")
    chosen = None if cfg.format is None else as_type(str, cfg.format, "format")
    count = as_type(int, cfg.count, "count")
    kind, scene = export_format(cfg.out, chosen, sequence=count > 0), load(cfg.scene)
    if count and time is not None:
        raise ValueError(
            f"time must be null with count={count}, got {time:g}. Leave one of them out."
        )
    if kind == "ftgs":
        if count or time is not None:
            raise ValueError("format=ftgs holds all times: leave time and count out.")
        message = export_transients(scene, cfg.out, color=color, degree=degree)
    elif count:
        message = export_sequence(scene, cfg.out, count, color=color, degree=degree, format=kind)
    else:
        _, message = export_model(scene, cfg.out, time, color=color, degree=degree, format=kind)
    say_result(f"{cfg.out}: {message}")


def _pack(cfg: Configuration, devices: int | None) -> None:
    from gaussray.camera.imu import ImuOptions
    from gaussray.dataset.layouts import check_imu_keys, write_layout
    from gaussray.dataset.pack import pack

    count = as_type(int, cfg.frames_per_tar, "frames_per_tar")
    layout, imu = as_type(str, cfg.layout, "layout"), build_options(ImuOptions, cfg.imu)
    check_imu_keys(imu, layout, "layout")
    if layout != "webdataset":
        frames = write_layout(cfg.data, cfg.out, layout, imu=imu)
        say_result(f"{cfg.out}: {frames} frames in the layout {layout}.")
        return
    written = pack(cfg.data, cfg.out, frames_per_tar=count)
    say_result(f"{cfg.out}: {counted(len(written), 'tar file')}.")


# The function of each command. It returns what the report shows: the scene, the capture. Two are
# apart, because they start devices on their own: `view`, and `render` of a data set (`generate`).
RUN: dict[str, Callable[[Configuration, int | None], dict[str, Any] | None]] = {
    "demo": run_demo,
    "reconstruct": run_reconstruct,
    "render": _render,
    "evaluate": _evaluate,
    "calibrate": _calibrate,
    "prepare": _prepare,
    "import": _import,
    "export": _export,
    "pack": _pack,
}
