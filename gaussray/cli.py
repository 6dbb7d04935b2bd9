"""One command, `gaussray <verb> [overrides]`: options in, a call of the library."""

import os
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from gaussray import provenance
from gaussray.alone import release, take
from gaussray.completion import script
from gaussray.configuration import (
    as_kind,
    configuration as configuration,
    options as options,
    run_folder,
)
from gaussray.devices import DevicesOptions, begin, leads, leave, together
from gaussray.guard.limits import Limits, limit
from gaussray.progress import STYLES, check_style, end_line, say, style, told_as
from gaussray.provenance import asked_by
from gaussray.shortage import is_full, is_memory, memory_message
from gaussray.suggestion import meant
from gaussray.usage import VERBS as VERBS, full_help, short_help, usage
from gaussray.vocabulary import conf_folder as conf_folder


# How an interrupted verb is gone on with.
AGAIN = {
    "reconstruct": "The same command with resume=true",
    "render": "The same command",
    "demo": "The same command",
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point. Errors of the user end in one line and exit code 2 (`usage.EXITS`)."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    with told_as(_style(words)), asked_by(words):
        _guarded(words)


def _guarded(words: list[str]) -> None:
    try:
        _main(words)
    except KeyboardInterrupt:
        if words[0] == "view":
            return
        _fail(f"interrupted. {_again(words[0])}", 130)
    except (ValueError, OSError, RuntimeError, MemoryError) as error:
        if is_memory(error) and not os.environ.get("GAUSSRAY_TRACEBACK"):
            _fail(memory_message(words[0], error, _again(words[0])))
        unknown = isinstance(error, RuntimeError) and type(error).__name__ != "NonFiniteLoss"
        if unknown or os.environ.get("GAUSSRAY_TRACEBACK"):
            _raise(error)
        told = str(error)
        if is_full(error):
            told = f"{told.rstrip('. ')}. The disk is full: make room. {_again(words[0])}"
        _fail(told)
    except Exception as error:
        _raise(error)
    finally:
        release()


def _again(verb: str) -> str:
    """How a verb that was stopped is gone on with."""
    return f"{AGAIN[verb]} goes on where it stopped." if verb in AGAIN else ""


def _main(words: list[str]) -> None:
    if not words or words[0] in ("-h", "--help"):
        print(usage())
    elif words[0] == "--version":
        print(f"gaussray {version('gaussray')}")
    elif words[0] in ("--completion", "-sc"):
        # Hydra's own way to ask for it is -sc install=bash.
        print(script(words[1].removeprefix("install=") if len(words) > 1 else "bash"), end="")
    elif words[0] not in VERBS:
        known = ", ".join(VERBS)
        raise ValueError(
            f"the verb must be one of {known}, got {words[0]!r}.{meant(words[0], VERBS)} See "
            "`gaussray --help`."
        )
    elif "--help=all" in words:
        print(full_help(words[0]))
    elif "-h" in words or "--help" in words:
        print(short_help(words[0]))
    else:
        _run(words[0], words[1:])


def _run(verb: str, overrides: Sequence[str]) -> None:
    began = time.monotonic()
    cfg = configuration(verb, overrides)
    check_style(str(cfg.get("progress", "auto")))
    limit(options(Limits, cfg.limits))
    if verb == "render" and cfg.factory.count:
        from gaussray.production import produce

        say(produce(cfg, overrides), "result", verb=verb, out=cfg.out)
        return
    if verb == "view":
        _view(cfg, overrides)
        return
    had = RUN[verb](cfg, begin(options(DevicesOptions, cfg.devices))) or {}
    out = Path(str(cfg.out))
    if leads() and (out / provenance.FILE).is_file():
        provenance.note_end(out, time.monotonic() - began)
        if cfg.get("report"):
            _page(verb, out, had)


def _style(words: Sequence[str]) -> str:
    """How the work is to be told of, also if another word is wrong."""
    told = [word.split("=", 1)[1] for word in words if word.startswith("progress=")]
    told = [name for name in told if name in STYLES]
    return (told or ["quiet" if "quiet=true" in words else "auto"])[-1]


def _page(verb: str, out: Path, had: dict[str, Any]) -> None:
    """The page to look at; if it cannot be made, the work is none the less done."""
    from gaussray.report import write_page

    try:
        write_page(verb, out, **had)
    except Exception as error:
        warnings.warn(
            f"{out / 'report.html'}: the page could not be made ({type(error).__name__}: {error}). "
            "Everything else is there.",
            stacklevel=2,
        )


def _fail(message: str, code: int = 2) -> None:
    message = " ".join(message.split())
    end_line()
    print(f"gaussray: {message}", file=sys.stderr)
    if style() == "json":
        say(message, "error", code=code)
    leave(code)


def _raise(error: Exception) -> None:
    """An error that is not the user's."""
    end_line()
    if not together():
        raise error
    traceback.print_exception(error)
    leave(1)


def reconstruct_options(cfg: DictConfig) -> Any:
    """ReconstructOptions of a configuration."""
    from gaussray import fitting as stage

    return stage.ReconstructOptions(
        fit=options(stage.FitOptions, cfg.fit),
        track=options(stage.TrackOptions, cfg.track),
        field=options(stage.FieldOptions, cfg.field),
        loss=options(stage.LossOptions, cfg.loss),
        optimizer=options(stage.OptimizerOptions, cfg.optimizer),
        density=options(stage.DensityOptions, cfg.density),
        trace=options(stage.TraceOptions, cfg.trace),
        need=options(stage.NeedOptions, cfg.need),
    )


def _capture(path: str, node: DictConfig, label: str, prefix: str = "") -> Any:
    """The capture at a path, as the keys of a node say that begin with `prefix`; `label` stands
    before them in messages."""
    from gaussray.capture.formats import open_capture
    from gaussray.capture.selection import Selection

    def told(kind: type, name: str) -> Any:
        value = node[prefix + name]
        plain = OmegaConf.to_container(value) if OmegaConf.is_config(value) else value
        return as_kind(kind, plain, f"{label}{name}")

    fields = Selection.__dataclass_fields__.items()
    chosen = {name: told(type(field.default), name) for name, field in fields}
    names = told(str, "format"), told(str, "background")
    return open_capture(path, *names, selection=Selection(**chosen))


def _reconstruct(cfg: DictConfig, devices: int | None) -> dict[str, Any]:
    from gaussray.evaluate import scene_facts
    from gaussray.fit.journal import refuse
    from gaussray.reconstruct import reconstruct

    chosen = reconstruct_options(cfg)
    capture = _capture(cfg.capture.path, cfg.capture, "capture.")
    # Whether there is a run to go on with is for nobody to ask while another process is at it.
    take(Path(cfg.out))
    resume = _resumes(cfg)
    if resume is None:
        out = Path(cfg.out)
        _say(f"{out / 'scene.npz'}: finished already. resume=false makes it anew.", out=str(out))
        return {}
    refuse(Path(cfg.out), resume=resume)
    out = run_folder(cfg)
    how: dict[str, Any] = {"devices": devices, "quiet": cfg.quiet, "told": _scalars(cfg, out)}
    scene = reconstruct(capture, out, options=chosen, resume=resume, **how)
    facts = scene_facts(scene)
    text = f"{out / 'scene.npz'}: {facts['gaussians']} Gaussians, of which {facts['moving']} move."
    _say(text, out=str(out), scene=facts)
    return {"scene": scene, "capture": capture}


def _resumes(cfg: DictConfig) -> bool | None:
    """Whether the run in `out` is gone on with; None if resume=auto finds nothing left to do."""
    if isinstance(cfg.resume, bool):
        return cfg.resume
    if cfg.resume != "auto":
        raise ValueError(f"resume must be true, false or auto, got {cfg.resume!r}.")
    out = Path(cfg.out)
    # requirement.json is written last, before the checkpoint goes.
    ended = (out / "requirement.json").is_file() and (out / "scene.npz").is_file()
    begun = (out / "checkpoint.npz").is_file()
    return None if ended and not begun else begun


def _scalars(cfg: DictConfig, out: Path) -> Callable[[dict[str, Any]], None] | None:
    """Who else is told the figures of a fit."""
    from gaussray.scalars import tensorboard

    return tensorboard(out / "tensorboard") if cfg.tensorboard and leads() else None


def _render(cfg: DictConfig, devices: int | None) -> dict[str, Any]:
    from gaussray.factory import film
    from gaussray.production import shot_of

    shot = shot_of(cfg)
    out = film(shot, run_folder(cfg), devices=devices, quiet=cfg.quiet)
    effect, count = shot.records[0].effect, len(shot.records)
    _say(f"{out}: {count} frames of {effect}.", out=str(out), frames=count, effect=effect)
    return {"scene": shot.scene}


def _view(cfg: DictConfig, overrides: Sequence[str]) -> None:
    from gaussray.view.serve import serve

    begin(options(DevicesOptions, cfg.devices))
    server = serve(cfg, overrides)
    _say(
        f"{server.url} shows {cfg.scene}; the first pictures take as long as their programs take "
        "to compile. Stop with Ctrl-C.",
        url=server.url,
    )
    server.wait()


def _evaluate(cfg: DictConfig, devices: int | None) -> dict[str, Any]:
    from gaussray.dataset.scores import table
    from gaussray.evaluate import EvaluateOptions, evaluate
    from gaussray.render import RenderOptions
    from gaussray.scene.store import load_scene
    from gaussray.tracer.trace import TraceOptions

    chosen, trace = options(EvaluateOptions, cfg.evaluate), options(TraceOptions, cfg.trace)
    render = options(RenderOptions, cfg.render)
    scene, truth = load_scene(cfg.scene), _capture(cfg.truth, cfg, "truth_", "truth_")
    if cfg.out == f"{cfg.scene}/evaluation" and Path(cfg.scene).is_file():
        cfg.out = str(Path(cfg.scene).parent / "evaluation")
    out = run_folder(cfg)
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
    _say(table(report), out=str(out), report=report)
    return {"scene": scene, "capture": truth}


def _calibrate(cfg: DictConfig, devices: int | None) -> None:
    from gaussray.calibrate import CalibrateOptions, calibrate
    from gaussray.findings import table
    from gaussray.scene.store import load_scene
    from gaussray.tracer.trace import TraceOptions

    chosen, trace = options(CalibrateOptions, cfg.calibrate), options(TraceOptions, cfg.trace)
    scene, capture = load_scene(cfg.scene), _capture(cfg.capture.path, cfg.capture, "capture.")
    out = run_folder(cfg)
    report = calibrate(scene, capture, out, options=chosen, trace=trace, quiet=cfg.quiet)
    _say(table(report), out=str(out), report=report)


def _import(cfg: DictConfig, devices: int | None) -> None:
    from gaussray.exchange import import_model

    color = as_kind(str, cfg.color, "color")
    iteration = None if cfg.iteration is None else as_kind(int, cfg.iteration, "iteration")
    scene, assumed = import_model(cfg.source, cfg.out, color=color, iteration=iteration)
    out = run_folder(cfg)
    _say(f"{out / 'scene.npz'}: {scene.static.count + scene.moving.count} Gaussians.\n{assumed}")


def _export(cfg: DictConfig, devices: int | None) -> None:
    from gaussray.exchange import export_model
    from gaussray.scene.store import load_scene

    if cfg.format != "ply":
        raise ValueError(f"format must be ply, got {cfg.format!r}.")
    time = None if cfg.time is None else as_kind(float, cfg.time, "time")
    color, degree = as_kind(str, cfg.color, "color"), as_kind(int, cfg.degree, "degree")
    _, said = export_model(load_scene(cfg.scene), cfg.out, time, color=color, degree=degree)
    _say(f"{cfg.out}: {said}")


def _pack(cfg: DictConfig, devices: int | None) -> None:
    from gaussray.dataset.pack import pack

    count = as_kind(int, cfg.frames_per_tar, "frames_per_tar")
    written = pack(cfg.data, cfg.out, frames_per_tar=count)
    _say(f"{cfg.out}: {len(written)} tar files.")


def _demo(cfg: DictConfig, devices: int | None) -> None:
    from gaussray.demo import demo
    from gaussray.evaluate import EvaluateOptions
    from gaussray.render import RenderOptions

    chosen = {
        "reconstruction": reconstruct_options(cfg),
        "render": options(RenderOptions, cfg.render),
        "evaluation": options(EvaluateOptions, cfg.evaluate),
    }
    out = run_folder(cfg)
    how: dict[str, Any] = {"devices": devices, "quiet": cfg.quiet, "told": _scalars(cfg, out)}
    demo(cfg.capture.path, out, **chosen, **how)


def _say(text: str, **facts: Any) -> None:
    """What came of it: said once, however many processes work together."""
    if leads():
        say(text, "result", **facts)


# What a verb does, and what of it the page shows: the scene, the capture.
RUN: dict[str, Callable[[DictConfig, int | None], dict[str, Any] | None]] = {
    "demo": _demo,
    "reconstruct": _reconstruct,
    "render": _render,
    "evaluate": _evaluate,
    "calibrate": _calibrate,
    "import": _import,
    "export": _export,
    "pack": _pack,
}


if __name__ == "__main__":
    main()
