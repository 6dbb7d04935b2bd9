"""Blender's pictures, recorded wrong on purpose, calibrated against a scene fitted to others.

python experiments/calibrate/recover.py SCENE CAPTURE OUT [EFFECT ...]   (see README.md)
"""

import json
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from gaussray.calibrate import CalibrateOptions, calibrate
from gaussray.calibrate.parameters import (
    corrected_camera,
    reported_values,
    unit_camera_set,
    unknowns,
)
from gaussray.calibrate.results import calibration_table
from gaussray.capture.formats.paired import read_capture
from gaussray.dataset.manifest import FrameRecord, write_manifest
from gaussray.geometry import RigidTransform, turning
from gaussray.io.safe.limits import Limits, limit
from gaussray.scene.store import load_scene


# One camera that the scene was not fitted to, and so many of its pictures.
CAMERA, FRAMES = "cam13", 2
FOUND = {
    "pinhole": ("pose", "focal"),
    "fisheye": ("pose", "focal", "lens"),
    "rolling_shutter": ("pose", "focal", "shutter"),
}
# Errors of the recording: logarithms of factors, focal lengths, radians, scene units; of the lens's
# coefficients, the angle that they add at half the sensor's width.
WRONG = {
    "focal": 0.05, "center.x": 0.02, "center.y": -0.02, "k3": 0.05, "readout": 0.3,
    "turn.right": 0.03, "turn.down": -0.03, "turn.forward": 0.03,
    "shift.right": 0.05, "shift.down": -0.05, "shift.forward": 0.1,
}  # fmt: skip


def main(scene, folder, out, *effects):
    # The lists written here name the capture's own pictures.
    limit(Limits(folders=(str(folder),)))
    scene, capture, out = load_scene(scene), read_capture(folder), Path(out)
    for effect in effects or FOUND:
        views = {"pinhole": capture.views, **capture.effects}[effect]
        views = [view for view in views if view.camera_name == CAMERA]
        wrong = out / effect / "wrong"
        truth = recorded(wrong, effect, views)
        options = CalibrateOptions(parameters=FOUND[effect], frames=FRAMES)
        found = calibrate(scene, read_capture(wrong), out / effect / "found", options=options)
        print(effect, calibration_table(found), sep="\n")
        for row in found["parameters"]:
            real = truth[row["name"]]
            errors = abs(row["start"] - real), abs(row["value"] - real)
            stated = [row["standard_error"][key] for key in ("independent", "tiles")]
            figures = dict(zip(("start", "end"), errors, strict=True))
            figures |= dict(zip(("independent", "tiles"), stated, strict=True))
            line = {"effect": effect, "name": row["name"], "unit": row["unit"]}
            rounded = {key: float(f"{x:.3g}") for key, x in figures.items()}
            print(json.dumps(line | rounded), flush=True)


def recorded(folder, effect, views):
    """The list with the errors in it, and what each number really is, as it is told."""
    kinds, first = FOUND[effect], views[0].camera
    told, unit = unknowns(kinds, first.lens), unit_camera_set(first)
    value = jnp.asarray([WRONG.get(one.name, 0.0) for one in told], first.time.dtype)
    spoilt = jax.jit(lambda camera: corrected_camera(value, camera, unit, told)[0])
    records = [
        FrameRecord(str(view.image.resolve()), spoilt(view.camera), CAMERA, view.split, effect)
        for view in views
    ]
    folder.mkdir(parents=True, exist_ok=True)
    write_manifest(folder / "transforms.json", records)
    real = reported_values(jnp.zeros_like(value), first, unit, told)
    truth = dict(zip((one.name for one in told), map(float, real), strict=True))
    # The way back: the turn is undone about the same axis, the shift as the turned camera sees it.
    turn, shift = (
        jnp.asarray([WRONG[f"{what}.{axis}"] for axis in ("right", "down", "forward")])
        for what in ("turn", "shift")
    )
    back = RigidTransform(turning(-turn), jnp.zeros(3)).rotate(-shift)
    for i, axis in enumerate(("right", "down", "forward")):
        truth[f"turn.{axis}"] = -float(np.degrees(turn[i]))
        truth[f"shift.{axis}"] = float(back[i])
    return truth


if __name__ == "__main__":
    main(*sys.argv[1:])
