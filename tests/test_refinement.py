"""Captures filmed with effects are learnt from, and cameras that were recorded wrong are found."""

import dataclasses

import numpy as np
import pytest
import toy

from gaussray.camera.camera import Camera
from gaussray.camera.lens import pinhole
from gaussray.camera.shutter import Shutter
from gaussray.camera.trajectory import Trajectory
from gaussray.capture.calibration import read_capture
from gaussray.dataset.images import write_image
from gaussray.dataset.manifest import FrameRecord, write_manifest
from gaussray.fit.course import FitOptions
from gaussray.fit.journal import Journal
from gaussray.fit.loss import LossOptions
from gaussray.fit.optimizer import OptimizerOptions, Parameters
from gaussray.fit.refinement import REFINABLE, no_corrections, settled
from gaussray.fit.state import begin_state
from gaussray.fitting import Fit
from gaussray.geometry import multiply, turning
from gaussray.render import Renderer, RenderOptions
from gaussray.scene.gaussians import unconstrain


pytestmark = pytest.mark.usefixtures("quick_compilation")

SIDE, TIMES, READOUT = 32, (0.2, 0.5, 0.8), 0.3
ANGLES = dict(zip(toy.CAMERAS[:3], (-0.45, 0.0, 0.45), strict=True))
SCENE = toy.scene()
# What is left of an error after the few steps of a test: 3 % of a readout and a gain, and a fifth
# of an error of a pose, a focal length or a time.
FRACTION, LEFT = 0.03, 0.2


def changed(camera, **parts):
    return Camera(**(vars(camera) | parts))


def frames():
    """Name and camera of every frame: pinholes whose rows are read one after the other."""
    return [
        (name, toy.rolling(toy.camera(angle, time, SIDE, SIDE), READOUT))
        for name, angle in ANGLES.items()
        for time in TIMES
    ]


@pytest.fixture(scope="module")
def pictures(quick_compilation):
    """What these cameras see of the toy, in linear light."""
    renderer = Renderer(SCENE, options=RenderOptions(samples=1), trace=toy.TRACE)
    return [renderer(camera).color for _, camera in frames()]


def recorded(folder, pictures, change=lambda name, camera: camera, gain=None):
    """The capture that these pictures are, its cameras recorded with a change, each picture
    brightened by its camera's gain."""
    records = []
    for i, ((name, camera), color) in enumerate(zip(frames(), pictures, strict=True)):
        path = f"images/{name}/{i:04d}.png"
        records.append(FrameRecord(path, change(name, camera), name, "train"))
        write_image(folder / path, color * np.float32(1 if gain is None else gain[name]))
    write_manifest(folder / "transforms.json", records, extra={"ply_file_path": "points3d.ply"})
    toy.write_points(folder / "points3d.ply", SCENE)
    return read_capture(folder)


def options(*refine, steps=100, **rates):
    """Nothing learns but what is refined."""
    still = {
        name: 0.0
        for name in OptimizerOptions.__dataclass_fields__
        if name not in ("decay", *REFINABLE)
    }
    return dataclasses.replace(
        toy.SHORT,
        fit=FitOptions(fine=steps, tiles=12, block=50, balance=0.8, refine=refine),
        optimizer=OptimizerOptions(**(still | {"decay": 0.05} | rates)),
        loss=LossOptions(space=0.0, time=0.0, one=0.0),
    )


def corrected(capture, folder, chosen):
    """What the fit makes of the cameras, the scene being known; and the cameras it was given."""
    fit = Fit(capture, Journal(folder, resume=False, interval=1e9), chosen, True)
    corrections = no_corrections(chosen.fit.refine, len(fit.names), fit.footage.camera)
    scene = unconstrain(SCENE.static), unconstrain(SCENE.moving), SCENE.deformation
    state = fit.run("fine", begin_state(Parameters(*scene, corrections)))
    return settled(state.parameters.corrections, fit.cameras), fit.cameras


def test_exposures_are_found(tmp_path, pictures):
    given = [1.2, 1.0, 0.9], [0.8, 1.0, 1.0], [1 / 0.96, 1, 1 / 0.9]
    gain = dict(zip(ANGLES, given, strict=True))
    capture = recorded(tmp_path / "capture", pictures, gain=gain)
    found, _ = corrected(capture, tmp_path, options("exposure", exposure=2e-2))
    np.testing.assert_allclose(np.exp(found.exposure), given, rtol=FRACTION)


def test_a_readout_that_is_wrong_by_30_percent_is_found(tmp_path, pictures):
    def slow(_, camera):
        return toy.rolling(camera, 1.3 * READOUT)

    capture = recorded(tmp_path / "capture", pictures, slow)
    found, _ = corrected(capture, tmp_path, options("shutter", shutter=2e-2))
    np.testing.assert_allclose(np.exp(found.shutter), 1 / 1.3, rtol=FRACTION)


def test_cameras_that_look_half_an_interval_too_late_are_found(tmp_path, pictures):
    late = dict(zip(ANGLES, (0.15, -0.05, -0.1), strict=True))

    def early(name, camera):
        row_offset = camera.shutter.row_offset - late[name]
        return changed(camera, shutter=Shutter(row_offset, camera.shutter.row_step, toy.single(0)))

    capture = recorded(tmp_path / "capture", pictures, early)
    found, cameras = corrected(capture, tmp_path, options("offset", offset=2e-2))
    delay = np.asarray(found.offset) * float(cameras.interval)
    np.testing.assert_allclose(delay, list(late.values()), atol=LEFT * 0.15)


def test_poses_that_are_off_by_half_a_degree_are_found(tmp_path, pictures):
    turn = dict(zip(ANGLES, np.radians(0.5) * np.eye(3), strict=True))

    def turned(name, camera):
        path = camera.trajectory
        quat = multiply(turning(toy.single(turn[name])), path.quat[0])[None]
        return changed(camera, trajectory=Trajectory(path.time, quat, path.translation))

    capture = recorded(tmp_path / "capture", pictures, turned)
    found, cameras = corrected(capture, tmp_path, options("pose", steps=200, pose=1e-3))
    # A similarity of all cameras cannot be seen, nor is it refined.
    back = np.concatenate([-np.stack(list(turn.values())), np.zeros((3, 3))], axis=1)
    expected = (np.asarray(cameras.free) @ back.reshape(-1)).reshape(back.shape)
    error = np.linalg.norm(np.asarray(found.pose) - expected)
    assert error < LEFT * np.linalg.norm(expected), (error, np.linalg.norm(expected))


def test_focal_lengths_that_are_wrong_by_2_percent_are_found(tmp_path, pictures):
    factor = dict(zip(ANGLES, (1.02, 0.98, 1.02), strict=True))

    def longer(name, camera):
        lens = camera.lens
        return changed(camera, lens=pinhole(toy.single(factor[name]) * lens.focal, lens.center))

    capture = recorded(tmp_path / "capture", pictures, longer)
    found, _ = corrected(capture, tmp_path, options("lens", lens=2e-3))
    expected = -np.log(list(factor.values()))
    np.testing.assert_allclose(found.lens[:, 0], expected, atol=LEFT * 0.02)
