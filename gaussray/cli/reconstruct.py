"""The commands that fit a scene: reconstruct, and the demo."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from gaussray.cli.result import say_result
from gaussray.cli.selected_capture import selected_capture
from gaussray.config.compose import Configuration
from gaussray.config.options import build_options
from gaussray.config.run_folder import begin_run_folder, changed_keys
from gaussray.runtime.devices import is_primary
from gaussray.runtime.lock import lock_output
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


def run_reconstruct(cfg: Configuration, devices: int | None) -> dict[str, Any]:
    """Fit a scene to a capture, unless the run in `out` is finished.

    Args:
        cfg: configuration of the command.
        devices: how many devices of this host to use; None is all.

    Returns:
        What the report shows: the scene and the capture; nothing where the run was finished.
    """
    read_ahead(f"reconstruct {Path(str(cfg.capture.path)).resolve()}")
    from gaussray.reconstruct.data.training_split import (
        demand_training_pictures,
        division_sentence,
    )
    from gaussray.reconstruct.pipeline import reconstruct
    from gaussray.reconstruct.run_state import demand_resumable
    from gaussray.reconstruct.same_capture import demand_same_capture
    from gaussray.scene.segmented import scene_size

    chosen = reconstruct_options(cfg)
    capture = selected_capture(cfg.capture.path, cfg.capture, "capture.")
    # Lock first: another process may be about to finish the run.
    lock_output(Path(cfg.out))
    resume = should_resume(cfg)
    if resume is None:
        out = Path(cfg.out)
        names = changed_keys(cfg)
        other = f" It has other values of {', '.join(names)}." if names else ""
        text = f"{out / 'scene.npz'}: is finished.{other} resume=false starts again."
        say_result(text, out=str(out))
        return {}
    demand_resumable(Path(cfg.out), resume=resume)
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
    say_result(text, out=str(out), scene=facts)
    return {"scene": scene, "capture": capture}


def should_resume(cfg: Configuration) -> bool | None:
    """Whether to resume the run in `out`; None if resume=auto finds it finished."""
    if isinstance(cfg.resume, bool):
        return cfg.resume
    if cfg.resume != "auto":
        raise ValueError(f"resume must be true, false or auto, got {cfg.resume!r}.")
    from gaussray.reconstruct.run_state import has_checkpoint, is_finished

    out = Path(cfg.out)
    return None if is_finished(out) else has_checkpoint(out)


def _tensorboard(cfg: Configuration, out: Path) -> Callable[[dict[str, Any]], None] | None:
    """A function that logs scalars for TensorBoard, None if it is off."""
    from gaussray.runtime.tensorboard import tensorboard

    return tensorboard(out / "tensorboard") if cfg.tensorboard and is_primary() else None


def run_demo(cfg: Configuration, devices: int | None) -> dict[str, Any]:
    """Reconstruct the sample capture, and score every effect.

    Args:
        cfg: configuration of the command.
        devices: how many devices of this host to use; None is all.

    Returns:
        What the report shows: the scene and the capture.
    """
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
