"""Keys without effect: a key chooses its group's kind, or is refused if the kind ignores it."""

import dataclasses
from typing import Any

from gaussray.camera.lens.registry import models_by_name
from gaussray.io.validate import changed_fields
from gaussray.render.rig.rig import CameraOptions, RigOptions


# Keys of a shutter that apply also where it is kept from the capture.
_KEPT_SHUTTER = ("trigger",)
# shutter.kind that a key asks for where the capture's shutter would be kept, first match first.
_KIND_OF_SHUTTER = {
    "row_times": "table",
    "field_time": "interlaced",
    "readout": "rolling",
    "row_step": "rolling",
    "exposure": "global",
}
_TRAJECTORY_KEYS = {
    "keep": ("interpolation",),
    "between": ("interpolation", "steps"),
    "path": ("interpolation", "steps", "file", "clock"),
}
_KEYS_OF_ALL_CAMERAS = ("clip_start",)
_CAMERA_KEYS = {
    "capture": ("split", "names", "times"),
    "look_at": ("eye", "target", "up", "frames", "times"),
    "orbit": ("eye", "target", "up", "frames", "turns"),
    "path": ("file", "frames"),
}
# Kinds that are not chosen by their own name.
_CHOICES = {"capture": "camera=default", "table": "shutter.kind=table"}


def apply_implied_choices(options: RigOptions) -> tuple[RigOptions, list[str]]:
    """Make the choices that keys imply: `shutter.readout=0.2` implies a rolling shutter.

    Returns:
        The options, and a line about each choice.
    """
    notes = []
    shutter, trajectory = options.shutter, options.trajectory
    changed = _changed(shutter)
    if shutter.kind == "keep":
        key = next((k for k in _KIND_OF_SHUTTER if k in changed), None)
        if key is not None:
            kind = _KIND_OF_SHUTTER[key]
            notes.append(_note("shutter", key, getattr(shutter, key), _choice("shutter", kind)))
            shutter = dataclasses.replace(shutter, kind=kind)
    if trajectory.kind == "keep" and trajectory.file and options.camera.kind == "capture":
        notes.append(_note("trajectory", "file", trajectory.file, "trajectory=path"))
        trajectory = dataclasses.replace(trajectory, kind="path")
    return dataclasses.replace(options, shutter=shutter, trajectory=trajectory), notes


def _note(group: str, key: str, value: Any, choice: str) -> str:
    return f"{group}.{key}={value} chooses {choice}."


def _choice(group: str, kind: str) -> str:
    return _CHOICES.get(kind, f"{group}={kind}")


def check_used_keys(options: RigOptions) -> None:
    """Check that the chosen models and kinds use every key that is set.

    Raises:
        ValueError: A key has no effect.
    """
    _check_lens(options)
    aperture, shutter, trajectory = options.aperture, options.shutter, options.trajectory
    if aperture.radius is None:
        remedy = "Set aperture.radius, or choose aperture=wide."
        _refuse("aperture", _changed(aperture), (), "aperture=keep", remedy)
    if shutter.kind == "keep":
        remedy = "Choose shutter=rolling, global or interlaced."
        _refuse("shutter", _changed(shutter), _KEPT_SHUTTER, "shutter=keep", remedy)
    if shutter.kind != "interlaced":
        used = set(_changed(shutter)) - {"first_field"}
        remedy = "Choose shutter=interlaced."
        _refuse("shutter", _changed(shutter), tuple(used), _choice("shutter", shutter.kind), remedy)
    if trajectory.kind in _TRAJECTORY_KEYS:
        # Generated datasets draw every seed, whether or not there is a shake.
        used = (*_TRAJECTORY_KEYS[trajectory.kind], "shake_degrees", "shake_distance", "shake_seed")
        if trajectory.shake_degrees or trajectory.shake_distance:
            used = (*used, "shake_time")
        remedy = "Choose trajectory=path or between, or set trajectory.shake_degrees."
        _refuse("trajectory", _changed(trajectory), used, f"trajectory={trajectory.kind}", remedy)
    _check_camera(options.camera)


def _check_camera(camera: CameraOptions) -> None:
    changed, used = _changed(camera), (*_CAMERA_KEYS[camera.kind], *_KEYS_OF_ALL_CAMERAS)
    ignored = next((key for key in changed if key not in used), None)
    if ignored is None:
        return
    first, *rest = (kind for kind, keys in _CAMERA_KEYS.items() if ignored in keys)
    remedy = f"Choose {' or '.join([_choice('camera', first), *rest])}."
    if camera.kind == "capture" and ignored == "frames":
        remedy += " Frames of the capture's cameras are chosen by their times: camera.times=[TIME]."
    _refuse("camera", changed, used, _choice("camera", camera.kind), remedy)


def _check_lens(options: RigOptions) -> None:
    lens = options.lens
    models = models_by_name()
    if lens.model == "keep":
        _refuse("lens", _changed(lens), (), "lens=keep", "Choose a lens, such as lens=pinhole.")
    elif lens.model in models:
        used = models[lens.model].option_keys
        keys = ", ".join(f"lens.{key}" for key in used)
        _refuse("lens", _changed(lens), used, f"lens.model={lens.model}", f"It has {keys}.")


def _changed(options: Any) -> list[str]:
    """The keys, without model and kind, that differ from their defaults."""
    return [name for name in changed_fields(options) if name not in ("model", "kind")]


def _refuse(
    group: str, changed: list[str], used: tuple[str, ...], choice: str, remedy: str
) -> None:
    for key in changed:
        if key not in used:
            raise ValueError(f"{group}.{key} has no effect with {choice}. {remedy}")
