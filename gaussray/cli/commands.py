"""The commands: each builds typed options from its configuration and calls the library."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from gaussray.config.compose import Configuration
from gaussray.config.options import as_type, build_options, field_value
from gaussray.config.run_folder import begin_run_folder, changed_keys
from gaussray.config.yaml_files import to_plain
from gaussray.runtime.devices import DevicesOptions, is_primary, start_devices
from gaussray.runtime.lock import lock_output
from gaussray.runtime.output import counted
from gaussray.runtime.progress import say
from gaussray.runtime.provenance import given_keys
from gaussray.runtime.recent_programs import read_ahead


def reconstruct_options(cfg: Configuration) -> Any:
    """The ReconstructOptions of a configuration. Keys of the command line stay as they are set."""
    from gaussray.reconstruct.options import ReconstructOptions

    defaults = ReconstructOptions()
    groups = [name for name in vars(defaults) if name in cfg]
    parts = {name: build_options(type(getattr(defaults, name)), cfg[name]) for name in groups}
    return ReconstructOptions(**parts, explicit_keys=given_keys())


def _capture(path: str, node: Configuration, label: str, prefix: str = "") -> Any:
    """Open the capture at a path with the selection (frames, crop, scale, ...) of a configuration.

    The keys of `node` that begin with `prefix` hold the selection; `label` stands before a key in
    messages.
    """
    from gaussray.capture.open import open_capture
    from gaussray.capture.selection import Selection

    def value(name: str) -> Any:
        return to_plain(node[prefix + name])

    fields = Selection.__dataclass_fields__.items()
    selection = Selection(**{n: field_value(f, value(n), f"{label}{n}") for n, f in fields})
    format, background = (
        as_type(str, value(name), f"{label}{name}") for name in ("format", "background")
    )
    return open_capture(path, format, background, selection=selection)


def _reconstruct(cfg: Configuration, devices: int | None) -> dict[str, Any]:
    read_ahead(f"reconstruct {Path(str(cfg.capture.path)).resolve()}")
    from gaussray.reconstruct.data.training_split import (
        demand_training_pictures,
        division_sentence,
    )
    from gaussray.reconstruct.log import refuse
    from gaussray.reconstruct.pipeline import reconstruct
    from gaussray.reconstruct.same_capture import demand_same_capture
    from gaussray.scene.segmented import scene_size

    chosen = reconstruct_options(cfg)
    capture = _capture(cfg.capture.path, cfg.capture, "capture.")
    # Lock first: another process may be about to finish the run.
    lock_output(Path(cfg.out))
    resume = should_resume(cfg)
    if resume is None:
        out = Path(cfg.out)
        names = changed_keys(cfg)
        other = f" It has other values of {', '.join(names)}." if names else ""
        text = f"{out / 'scene.npz'}: is finished.{other} resume=false starts again."
        _say(text, out=str(out))
        return {}
    refuse(Path(cfg.out), resume=resume)
    if resume:
        demand_same_capture(Path(cfg.out), capture)
    demand_training_pictures(capture, list(cfg.capture.frames))
    out = begin_run_folder(cfg)
    if is_primary() and not cfg.quiet:
        chosen_test = list(cfg.capture.test) != ["auto"]
        say(division_sentence(capture, chosen_test, list(cfg.capture.frames)))
    scene = reconstruct(
        capture,
        out,
        options=chosen,
        resume=resume,
        devices=devices,
        quiet=cfg.quiet,
        listener=_tensorboard(cfg, out),
    )
    facts = scene_size(scene)
    text = f"{out / 'scene.npz'}: {facts['gaussians']} Gaussians, of which {facts['moving']} move"
    text += f" and {facts['transient']} are transient." if facts.get("transient") else "."
    text += f" Look at them: gaussray view scene={out}"
    _say(text, out=str(out), scene=facts)
    return {"scene": scene, "capture": capture}


def should_resume(cfg: Configuration) -> bool | None:
    """Whether to resume the run in `out`; None if resume=auto finds it finished."""
    if isinstance(cfg.resume, bool):
        return cfg.resume
    if cfg.resume != "auto":
        raise ValueError(f"resume must be true, false or auto, got {cfg.resume!r}.")
    out = Path(cfg.out)
    # requirement.json is written last, before the checkpoint is removed.
    finished = (out / "requirement.json").is_file() and (out / "scene.npz").is_file()
    interrupted = (out / "checkpoint.npz").is_file()
    return None if finished and not interrupted else interrupted


def _tensorboard(cfg: Configuration, out: Path) -> Callable[[dict[str, Any]], None] | None:
    """A function that logs scalars for TensorBoard, None if it is off."""
    from gaussray.runtime.tensorboard import tensorboard

    return tensorboard(out / "tensorboard") if cfg.tensorboard and is_primary() else None


def _render(cfg: Configuration, devices: int | None) -> dict[str, Any]:
    from gaussray.config.jobs import render_job
    from gaussray.render.dataset import render_dataset

    for name, value in (("dataset.layout", cfg.dataset.layout), ("sample", cfg.sample)):
        if value:
            raise ValueError(f"{name} needs dataset.count of at least 1, got 0.")
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
    _say(text, out=str(out), frames=count, effect=effect)
    return {"scene": job.scene}


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
    _say(
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
    scene, truth = load(cfg.scene), _capture(cfg.truth, cfg, "truth_", "truth_")
    truth = with_found_cameras(truth, Path(cfg.scene))
    if cfg.out == f"{cfg.scene}/evaluation" and Path(cfg.scene).is_file():
        # Several scenes may be files of one folder; that of a run has its evaluation there.
        file = Path(cfg.scene)
        own = "" if file.name == "scene.npz" else f"{file.stem}_"
        cfg.out = str(file.parent / f"{own}evaluation")
    out = begin_run_folder(cfg)
    report = evaluate(
        scene,
        truth,
        out,
        options=chosen,
        render=render,
        trace=trace,
        devices=devices,
        quiet=cfg.quiet,
    )
    _say(scores_text(report), out=str(out), report=report)
    return {"scene": scene, "capture": truth}


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
    scene, capture = load(cfg.scene), _capture(cfg.capture.path, cfg.capture, "capture.")
    out = begin_run_folder(cfg)
    report = calibrate(scene, capture, out, options=chosen, trace=trace, quiet=cfg.quiet)
    _say(calibration_table(report), out=str(out), report=report)
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
    _say(text, out=str(out), findings=facts["findings"])


def _import(cfg: Configuration, devices: int | None) -> None:
    from gaussray.scene.formats.convert import import_model

    color = as_type(str, cfg.color, "color")
    iteration = None if cfg.iteration is None else as_type(int, cfg.iteration, "iteration")
    scene, assumed = import_model(cfg.source, cfg.out, color=color, iteration=iteration)
    out = begin_run_folder(cfg)
    _say(f"{out / 'scene.npz'}: {scene.count} Gaussians.\n{assumed}")


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
    _say(f"{cfg.out}: {message}")


def _pack(cfg: Configuration, devices: int | None) -> None:
    from gaussray.camera.imu import ImuOptions
    from gaussray.dataset.layouts import write_layout
    from gaussray.dataset.pack import pack

    count = as_type(int, cfg.frames_per_tar, "frames_per_tar")
    layout = as_type(str, cfg.layout, "layout")
    if layout != "webdataset":
        imu = build_options(ImuOptions, cfg.imu)
        frames = write_layout(cfg.data, cfg.out, layout, imu=imu)
        _say(f"{cfg.out}: {frames} frames in the layout {layout}.")
        return
    written = pack(cfg.data, cfg.out, frames_per_tar=count)
    _say(f"{cfg.out}: {counted(len(written), 'tar file')}.")


def _demo(cfg: Configuration, devices: int | None) -> dict[str, Any]:
    from gaussray.capture.formats.paired import read_capture
    from gaussray.cli.demo import DemoOptions, demo
    from gaussray.evaluate.options import EvaluateOptions
    from gaussray.io.sample_data import sample
    from gaussray.render.options import RenderOptions
    from gaussray.scene.store import load_scene

    options = DemoOptions(
        reconstruct_options(cfg),
        build_options(RenderOptions, cfg.render),
        build_options(EvaluateOptions, cfg.evaluate),
    )
    out = begin_run_folder(cfg)
    demo(
        cfg.capture.path,
        out,
        options=options,
        devices=devices,
        quiet=cfg.quiet,
        listener=_tensorboard(cfg, out),
    )
    capture = read_capture(cfg.capture.path or sample("capture"))
    return {"scene": load_scene(out), "capture": capture}


def _say(text: str, **facts: Any) -> None:
    """Print the result of a command, once for all processes."""
    if is_primary():
        say(text, "result", **facts)


# The function of each command. It returns what the report shows: the scene, the capture.
RUN: dict[str, Callable[[Configuration, int | None], dict[str, Any] | None]] = {
    "demo": _demo,
    "reconstruct": _reconstruct,
    "render": _render,
    "evaluate": _evaluate,
    "calibrate": _calibrate,
    "prepare": _prepare,
    "import": _import,
    "export": _export,
    "pack": _pack,
}
