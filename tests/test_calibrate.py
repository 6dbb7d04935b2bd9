"""Cameras that are recorded wrong are found in pictures of a known scene, and how well."""

import dataclasses
import json

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.calibrate import CalibrateOptions, calibrate
from gaussray.camera.lens import KannalaBrandt, pinhole
from gaussray.capture.calibration import read_capture, read_views
from gaussray.cli import main
from gaussray.dataset.images import write_image
from gaussray.dataset.manifest import FrameRecord, write_manifest
from gaussray.fit.unknowns import applied, units, unknowns
from gaussray.render import Renderer, RenderOptions
from gaussray.scene.store import save_scene


pytestmark = pytest.mark.usefixtures("quick_compilation")

SIDE, TIMES, READOUT = 32, (0.3, 0.7), 0.3
# The bodies as far apart as the picture is high: rows that see nothing move say nothing of time.
SCENE = toy.scene()
SCENE = eqx.tree_at(lambda s: s.moving.mean, SCENE, SCENE.moving.mean * toy.single([[1, 2, 1]]))
MIDDLE = toy.single([SIDE / 2] * 2)
OPENCV = pinhole(2.2 * MIDDLE, MIDDLE, toy.single([-0.15, 0.04, 0, 0, 0, 0, 0, 0]))
FISHEYE = KannalaBrandt(1.8 * MIDDLE, MIDDLE, toy.single([0.06, -0.02, 0, 0]), toy.single(1.3))
GAIN = toy.single([1.2, 1.0, 0.85])
# What is wrong with a recording: logarithms of factors, focal lengths, radians, scene units.
WRONG = {
    "focal": 0.03, "center.x": 0.01, "center.y": -0.01, "k1": 0.03, "k2": -0.02, "readout": 0.2,
    "turn.right": 0.01, "turn.down": -0.01, "turn.forward": 0.02,
    "shift.right": 0.03, "shift.down": -0.02, "shift.forward": 0.04,
}  # fmt: skip
# What 8-bit pictures leave: of their rounding a few standard errors, and a share of the start's
# error that key states at other times and cut-offs make.
ERRORS, LEFT = 5.0, 0.05


def filmed(lens, readout=READOUT):
    """The cameras that take the pictures."""
    cameras = [toy.camera(0.15, time, SIDE, SIDE) for time in TIMES]
    if readout:
        cameras = [toy.rolling(camera, readout) for camera in cameras]
    return [dataclasses.replace(camera, lens=lens) for camera in cameras]


def recorded(cameras, kinds):
    """The same cameras with errors of these kinds."""
    told, unit = unknowns(kinds, cameras[0].lens), units(cameras[0])
    value = toy.single([WRONG.get(one.name, 0.0) for one in told])
    return [jax.jit(lambda c: applied(value, c, unit, told)[0])(camera) for camera in cameras]


def pictures(cameras, gain=1.0, scene=SCENE):
    renderer = Renderer(scene, options=RenderOptions(samples=1), trace=toy.TRACE)
    return [gain * np.asarray(renderer(camera).color) for camera in cameras]


def written(folder, cameras, shots):
    """A capture of these pictures, recorded by these cameras."""
    records = []
    for i, (camera, color) in enumerate(zip(cameras, shots, strict=True)):
        records.append(FrameRecord(f"images/{i:04d}.png", camera, "cam", "train"))
        write_image(folder / records[-1].file_path, color)
    write_manifest(folder / "transforms.json", records, extra={"time_unit": "s"})
    return folder


def assert_found(report, truth, *, left=LEFT):
    """Every number that is told is as near to the truth as it says, or all but there."""
    for row in report["parameters"]:
        if row["name"] in truth:
            error = abs(row["value"] - truth[row["name"]])
            begun = abs(row["start"] - truth[row["name"]])
            assert error < max(left * begun, ERRORS * row["standard_error"]["independent"]), row


@pytest.fixture(scope="module")
def run(tmp_path_factory, quick_compilation):
    """A scene, a capture whose camera is recorded wrong in everything, and what became of it."""
    folder = tmp_path_factory.mktemp("calibrate")
    truth = filmed(OPENCV)
    kinds = ("focal", "lens", "shutter", "pose")
    save_scene(folder / "scene.npz", SCENE)
    written(folder / "capture", recorded(truth, kinds), pictures(truth, np.asarray(GAIN)))
    main(
        ["calibrate", f"scene={folder}/scene.npz", f"capture.path={folder}/capture",
         f"out={folder}/found", "calibrate.parameters=[focal,lens,shutter,pose,exposure]",
         "calibrate.coarsest=32", "quiet=true"]
    )  # fmt: skip
    return folder


def test_everything_that_is_recorded_wrong_is_found_at_once(run):
    report = json.loads((run / "found" / "report.json").read_text())
    truth = {"focal": 2.2 * SIDE / 2, "center.x": SIDE / 2, "center.y": SIDE / 2}
    truth |= {"k1": -0.15, "k2": 0.04, "readout": READOUT}
    truth |= dict(zip(("gain.red", "gain.green", "gain.blue"), map(float, GAIN), strict=True))
    print(report)
    assert_found(report, truth)
    assert report["psnr"]["after"] > report["psnr"]["before"] + 10


def test_the_list_that_is_left_holds_the_camera_as_found(run):
    found = read_views(run / "found" / "transforms.json")
    begun = read_capture(run / "capture").views
    for view, before, camera in zip(found, begun, filmed(OPENCV), strict=True):
        assert view.image == before.image.resolve()
        away, start = (
            float(jnp.linalg.norm(c.trajectory.translation - camera.trajectory.translation))
            for c in (view.camera, before.camera)
        )
        assert away < 0.2 * start
        np.testing.assert_allclose(view.camera.lens.focal, camera.lens.focal, rtol=0.01)


def test_a_readout_that_no_picture_shows_is_refused_by_name(tmp_path):
    still = toy.scene(speed=0)
    cameras = filmed(OPENCV)
    capture = read_capture(written(tmp_path, cameras, pictures(cameras, scene=still)))
    with pytest.raises(ValueError, match="readout has no effect on these pictures .*moves"):
        chosen = CalibrateOptions(parameters=("shutter",), coarsest=32)
        calibrate(still, capture, tmp_path, options=chosen, trace=toy.TRACE, quiet=True)
