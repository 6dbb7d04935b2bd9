"""One command, `gaussray <verb> [overrides]`: options in, a call of the library."""

import os
import sys
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from gaussray.configuration import (
    as_kind,
    conf_folder as conf_folder,
    configuration as configuration,
    options as options,
    run_folder,
)
from gaussray.devices import DevicesOptions, begin, leads, leave, together
from gaussray.guard.limits import Limits, limit


VERBS = {
    "demo": "reconstruct the sample capture, film it through every effect, score it",
    "reconstruct": "multi-view video in, a scene out",
    "render": "a scene and cameras in, a paired capture and videos out; or a data set of many",
    "view": "a web page with the scene under the mouse and a camera's numbers as controls",
    "evaluate": "score a scene against a paired capture",
    "calibrate": "find cameras in pictures of a known scene, with standard errors",
    "import": "a model of 3D Gaussian Splatting or 4DGaussians in, a scene out",
    "export": "a scene at one instant as a 3D Gaussian Splatting model",
    "pack": "a produced data set as tar files that stream (WebDataset)",
}
USAGE = "usage: gaussray <verb> [key=value ...]\n\n" + "\n".join(
    f"  {verb:<12} {text}" for verb, text in VERBS.items()
)
USAGE += "\n\n`gaussray <verb> --help` lists the keys with their defaults."


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point. Errors of the user end in one line and exit code 2."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    if not words or words[0] in ("-h", "--help"):
        print(USAGE)
        return
    verb, overrides = words[0], words[1:]
    if verb not in VERBS:
        _fail(f"the verb must be one of {', '.join(VERBS)}, got {verb!r}. See `gaussray --help`.")
    if any(word in ("-h", "--help") for word in overrides):
        print(help_text(verb))
        return
    try:
        _run(verb, overrides)
    except KeyboardInterrupt:
        if verb == "view":
            return
        how = "`gaussray reconstruct ... resume=true`"
        how = "The same command" if verb == "render" else how
        _fail(f"interrupted. {how} goes on where it stopped.", 130)
    except (ValueError, OSError, RuntimeError) as error:
        unknown = isinstance(error, RuntimeError) and type(error).__name__ != "NonFiniteLoss"
        if unknown or os.environ.get("GAUSSRAY_TRACEBACK"):
            _raise(error)
        _fail(str(error))
    except Exception as error:
        _raise(error)


def _run(verb: str, overrides: Sequence[str]) -> None:
    cfg = configuration(verb, overrides)
    limit(options(Limits, cfg.limits))
    if verb == "render" and cfg.factory.count:
        from gaussray.production import produce

        print(produce(cfg, overrides))
    elif verb == "view":
        _view(cfg, overrides)
    else:
        RUN[verb](cfg, begin(options(DevicesOptions, cfg.devices)))


def help_text(verb: str) -> str:
    """The groups and keys of a verb, with defaults and comments, as the YAML files have them."""
    folder = conf_folder()
    lines = [f"gaussray {verb}: {VERBS[verb]}", ""]
    top = (folder / f"{verb}.yaml").read_text()
    defaults = OmegaConf.load(folder / f"{verb}.yaml").get("defaults")  # type: ignore[call-arg]
    for line in top.split("_self_", 1)[1].splitlines():
        lines += [f"  {line}"] if line.strip() else []
    for entry in defaults:
        if entry == "_self_":
            continue
        ((group, chosen),) = entry.items()
        choices = sorted(path.stem for path in (folder / group).glob("*.yaml"))
        lines += ["", f"{group}={chosen}   (choices: {', '.join(choices)})"]
        for line in (folder / group / f"{chosen}.yaml").read_text().splitlines():
            if line and not line.startswith("#"):
                lines.append(f"  {group}.{line}")
    return "\n".join(lines)


def _fail(message: str, code: int = 2) -> None:
    print(f"gaussray: {' '.join(message.split())}", file=sys.stderr)
    leave(code)


def _raise(error: Exception) -> None:
    """An error that is not the user's."""
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


def _reconstruct(cfg: DictConfig, devices: int | None) -> None:
    from gaussray.evaluate import scene_facts
    from gaussray.fit.journal import refuse
    from gaussray.reconstruct import reconstruct

    chosen = reconstruct_options(cfg)
    capture = _capture(cfg.capture.path, cfg.capture, "capture.")
    refuse(Path(cfg.out), resume=cfg.resume)
    out = run_folder(cfg)
    scene = reconstruct(
        capture, out, options=chosen, resume=cfg.resume, devices=devices, quiet=cfg.quiet
    )
    facts = scene_facts(scene)
    _say(f"{out / 'scene.npz'}: {facts['gaussians']} Gaussians, of which {facts['moving']} move.")


def _render(cfg: DictConfig, devices: int | None) -> None:
    from gaussray.factory import film
    from gaussray.production import shot_of

    shot = shot_of(cfg)
    out = film(shot, run_folder(cfg), devices=devices, quiet=cfg.quiet)
    _say(f"{out}: {len(shot.records)} frames of {shot.records[0].effect}.")


def _view(cfg: DictConfig, overrides: Sequence[str]) -> None:
    from gaussray.view.serve import serve

    begin(options(DevicesOptions, cfg.devices))
    server = serve(cfg, overrides)
    _say(f"{server.url} shows {cfg.scene}; the first pictures take as long as their programs take "
         "to compile. Stop with Ctrl-C.")  # fmt: skip
    server.wait()


def _evaluate(cfg: DictConfig, devices: int | None) -> None:
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
    _say(table(report))


def _calibrate(cfg: DictConfig, devices: int | None) -> None:
    from gaussray.calibrate import CalibrateOptions, calibrate
    from gaussray.findings import table
    from gaussray.scene.store import load_scene
    from gaussray.tracer.trace import TraceOptions

    chosen, trace = options(CalibrateOptions, cfg.calibrate), options(TraceOptions, cfg.trace)
    scene, capture = load_scene(cfg.scene), _capture(cfg.capture.path, cfg.capture, "capture.")
    out = run_folder(cfg)
    _say(table(calibrate(scene, capture, out, options=chosen, trace=trace, quiet=cfg.quiet)))


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
    demo(cfg.capture.path, run_folder(cfg), **chosen, devices=devices, quiet=cfg.quiet)


def _say(text: str) -> None:
    """What is said once, however many processes work together."""
    if leads():
        print(text)


RUN: dict[str, Callable[[DictConfig, int | None], None]] = {
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
