"""One command, `gaussray <verb> [overrides]`: Hydra in, typed options out."""

import os
import sys
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar, get_args

import equinox as eqx
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from gaussray.devices import DevicesOptions, begin, leads, leave, together


T = TypeVar("T", bound=eqx.Module)

VERBS = {
    "demo": "reconstruct the sample capture, film it through every effect, score it",
    "reconstruct": "multi-view video in, a scene out",
    "render": "a scene and cameras in, a paired capture and videos out",
    "evaluate": "score a scene against a paired capture",
    "calibrate": "find cameras in pictures of a known scene, with standard errors",
    "import": "a model of 3D Gaussian Splatting or 4DGaussians in, a scene out",
    "export": "a scene at one instant as a 3D Gaussian Splatting model",
}
USAGE = "usage: gaussray <verb> [key=value ...]\n\n" + "\n".join(
    f"  {verb:<12} {text}" for verb, text in VERBS.items()
)
USAGE += "\n\n`gaussray <verb> --help` lists the keys with their defaults."


def conf_folder() -> Path:
    """The configuration: beside the package in a checkout, inside it when installed."""
    package = Path(__file__).resolve().parent
    inside, beside = package / "conf", package.parent / "conf"
    return inside if inside.is_dir() else beside


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
        cfg = configuration(verb, overrides)
        RUN[verb](cfg, begin(options(DevicesOptions, cfg.devices)))
    except KeyboardInterrupt:
        _fail("interrupted. `gaussray reconstruct ... resume=true` goes on where it stopped.", 130)
    except (ValueError, OSError, RuntimeError) as error:
        unknown = isinstance(error, RuntimeError) and type(error).__name__ != "NonFiniteLoss"
        if unknown or os.environ.get("GAUSSRAY_TRACEBACK"):
            _raise(error)
        _fail(str(error))
    except Exception as error:
        _raise(error)


def configuration(verb: str, overrides: Sequence[str]) -> DictConfig:
    """The resolved configuration of a verb."""
    GlobalHydra.instance().clear()
    try:
        with initialize_config_dir(version_base="1.3", config_dir=str(conf_folder())):
            cfg = compose(verb, list(overrides))
        missing = sorted(OmegaConf.missing_keys(cfg))
        if missing:
            raise ValueError(
                f"{missing[0]} must be given, e.g. `gaussray {verb} {missing[0]}=DIR`."
            )
        OmegaConf.resolve(cfg)
    except (HydraException, OmegaConfBaseException) as error:
        reason = str(error).splitlines()[0]
        raise ValueError(
            f"configuration: {reason} `gaussray {verb} --help` lists the keys."
        ) from error
    return cfg


def options(kind: type[T], node: DictConfig) -> T:
    """One YAML leaf becomes one options object; an unknown key is an error. `null` is for keys
    that are `X | None`."""
    values: dict[str, Any] = OmegaConf.to_container(node, resolve=True)  # type: ignore[assignment]
    known = kind.__dataclass_fields__  # type: ignore[attr-defined]
    group = node._key() or kind.__name__
    for name, value in values.items():
        if name not in known:
            raise ValueError(f"{group}.{name} is unknown; known are {', '.join(known)}.")
        default, kinds = known[name].default, get_args(known[name].type)
        if isinstance(value, list) and float in kinds:
            for wrong in (x for x in value if type(x) not in (int, float)):
                raise ValueError(f"{group}.{name} must be a list of numbers, got {wrong!r} in it.")
            value = [float(x) if type(x) is int else x for x in value]
        if default is None and value is not None:
            values[name] = _as(kinds[0], value, f"{group}.{name}")
        else:
            values[name] = _as(type(default), value, f"{group}.{name}")
    return kind(**values)


def _as(kind: type, value: Any, key: str) -> Any:
    """A YAML value as the kind of its default; whole numbers do for fractions."""
    if kind is tuple and isinstance(value, list):
        return tuple(value)
    if kind is float and type(value) is int:
        return float(value)
    if type(value) is kind:
        return value
    names = {int: "a whole number", float: "a number", bool: "true or false", tuple: "a list"}
    raise ValueError(f"{key} must be {names.get(kind, 'a text')}, got {value!r}.")


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
        return _as(kind, plain, f"{label}{name}")

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
    out = _run_folder(cfg)
    scene = reconstruct(
        capture, out, options=chosen, resume=cfg.resume, devices=devices, quiet=cfg.quiet
    )
    facts = scene_facts(scene)
    _say(f"{out / 'scene.npz'}: {facts['gaussians']} Gaussians, of which {facts['moving']} move.")


def _render(cfg: DictConfig, devices: int | None) -> None:
    from gaussray import physical, rig as rigs
    from gaussray.camera.sensor import SensorOptions
    from gaussray.filming import render_dataset
    from gaussray.labels import check_labels
    from gaussray.render import RenderOptions
    from gaussray.scene.store import load_scene
    from gaussray.tracer.trace import TraceOptions

    wanted = rigs.RigOptions(
        camera=options(rigs.CameraOptions, cfg.camera),
        lens=options(rigs.LensOptions, cfg.lens),
        aperture=options(rigs.ApertureOptions, cfg.aperture),
        shutter=options(rigs.ShutterOptions, cfg.shutter),
        trajectory=options(rigs.TrajectoryOptions, cfg.trajectory),
        film=options(rigs.FilmOptions, cfg.film),
    )
    given = options(physical.PhysicalOptions, cfg.physical)
    sensor = options(SensorOptions, cfg.sensor)
    sampling, trace = options(RenderOptions, cfg.render), options(TraceOptions, cfg.trace)
    fps = _as(float, cfg.fps, "fps")
    if not fps > 0:
        raise ValueError(f"fps must be above 0, got {fps}.")
    named = OmegaConf.to_container(cfg.labels) if OmegaConf.is_config(cfg.labels) else cfg.labels
    asked = _as(tuple, named, "labels")
    check_labels(asked)
    scene = load_scene(cfg.scene)
    views = rigs.cameras_of(cfg.scene, cfg.cameras)
    film = physical.applied(wanted, given)
    records = rigs.rig(
        views, options=film, samples=sampling.samples, format=_as(str, cfg.format, "format")
    )
    physical.check_shape(given, (record.camera.film for record in records))
    out = render_dataset(
        scene,
        records,
        _run_folder(cfg),
        options=sampling,
        trace=trace,
        sensor=sensor,
        info=physical.described(wanted, given),
        labels=asked,
        fps=fps,
        devices=devices,
        quiet=cfg.quiet,
    )
    _say(f"{out}: {len(records)} frames of {records[0].effect}.")


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
    out = _run_folder(cfg)
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
    out = _run_folder(cfg)
    _say(table(calibrate(scene, capture, out, options=chosen, trace=trace, quiet=cfg.quiet)))


def _import(cfg: DictConfig, devices: int | None) -> None:
    from gaussray.exchange import import_model

    color = _as(str, cfg.color, "color")
    iteration = None if cfg.iteration is None else _as(int, cfg.iteration, "iteration")
    scene, assumed = import_model(cfg.source, cfg.out, color=color, iteration=iteration)
    out = _run_folder(cfg)
    _say(f"{out / 'scene.npz'}: {scene.static.count + scene.moving.count} Gaussians.\n{assumed}")


def _export(cfg: DictConfig, devices: int | None) -> None:
    from gaussray.exchange import export_model
    from gaussray.scene.store import load_scene

    if cfg.format != "ply":
        raise ValueError(f"format must be ply, got {cfg.format!r}.")
    time = None if cfg.time is None else _as(float, cfg.time, "time")
    color, degree = _as(str, cfg.color, "color"), _as(int, cfg.degree, "degree")
    _, said = export_model(load_scene(cfg.scene), cfg.out, time, color=color, degree=degree)
    _say(f"{cfg.out}: {said}")


def _demo(cfg: DictConfig, devices: int | None) -> None:
    from gaussray.demo import demo
    from gaussray.evaluate import EvaluateOptions
    from gaussray.render import RenderOptions

    chosen = {
        "reconstruction": reconstruct_options(cfg),
        "render": options(RenderOptions, cfg.render),
        "evaluation": options(EvaluateOptions, cfg.evaluate),
    }
    demo(cfg.capture.path, _run_folder(cfg), **chosen, devices=devices, quiet=cfg.quiet)


def _say(text: str) -> None:
    """What is said once, however many processes work together."""
    if leads():
        print(text)


def _run_folder(cfg: DictConfig) -> Path:
    """The output folder, with the resolved configuration in it."""
    out = Path(cfg.out)
    try:
        out.mkdir(parents=True, exist_ok=True)
        if leads():
            (out / "config.yaml").write_text(OmegaConf.to_yaml(cfg))
    except OSError as error:
        raise OSError(f"out={out}: cannot be written: {error}") from error
    return out


RUN: dict[str, Callable[[DictConfig, int | None], None]] = {
    "demo": _demo,
    "reconstruct": _reconstruct,
    "render": _render,
    "evaluate": _evaluate,
    "calibrate": _calibrate,
    "import": _import,
    "export": _export,
}


if __name__ == "__main__":
    main()
