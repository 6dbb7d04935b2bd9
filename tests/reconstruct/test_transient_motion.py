"""fit.motion=transient and control_points: what moves is learnt; a run can be interrupted."""

import itertools
import json
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy
from numpy.testing import assert_allclose

from gaussray.capture.errors import CaptureWarning
from gaussray.capture.formats.paired import read_capture
from gaussray.reconstruct import motion, moving_clouds
from gaussray.reconstruct.initialize.stereo.from_pictures import MovingPoints
from gaussray.reconstruct.initialize.stereo.points import StereoPoints
from gaussray.reconstruct.optimize.density import DensityOptions
from gaussray.reconstruct.options import FitOptions
from gaussray.reconstruct.pipeline import reconstruct
from gaussray.scene.scene import at
from gaussray.scene.store import load_scene
from gaussray.scene.transient import Transients


pytestmark = pytest.mark.usefixtures("known_sizes")

FIT = FitOptions(
    auto=False, coarse=1, fine=120, tiles=4, block=20, checkpoint=0.0, points=27, surround=0.0,
    start="given", motion="transient",
)  # fmt: skip
OPTIONS = replace(
    toy.SHORT,
    fit=FIT,
    density=DensityOptions(kind="relocate", interval=40, opacity=0.005, gaussians=48),
)
# The loss of the toy falls at least by this factor: what moves is learnt.
FALL = 1.5


def on_bodies(clouds, times, *, count, degree, **_):
    """Grey transient Gaussians where the two bodies of the toy are at every time."""
    scene, first = toy.scene(), 25
    mean = np.concatenate([np.asarray(at(scene, toy.single(t)).mean)[first:] for t in times])
    number = len(mean)
    still = toy.gaussians(mean, 0.2, [0.5, 0.5, 0.5], 0.5)
    return Transients(
        mean=still.mean,
        velocity=jnp.zeros((number, 3), jnp.float32),
        quat=still.quat,
        scale=still.scale,
        opacity=still.opacity,
        harmonics=still.harmonics,
        instant=toy.single(np.repeat(times, 2)),
        lifetime=jnp.full(number, 0.5, jnp.float32),
        plateau=jnp.zeros(number, jnp.float32),
    )


@pytest.fixture(autouse=True)
def stereo(monkeypatch):
    """Stereo that finds the bodies, which pictures of 16 x 16 pixels do not show."""
    monkeypatch.setattr(motion, "initial_transients", on_bodies)
    monkeypatch.setattr(moving_clouds, "moving_points", lambda *_, **__: [])


@pytest.fixture(scope="module")
def capture(tmp_path_factory, known_sizes):
    return read_capture(toy.write_capture(tmp_path_factory.mktemp("capture"), toy.scene()))


@pytest.mark.ci
def test_what_moves_is_learnt_and_an_interrupted_run_goes_on_to_the_same_bytes(
    capture, tmp_path, monkeypatch
):
    one, two = tmp_path / "one", tmp_path / "two"
    reconstruct(capture, one, options=OPTIONS, quiet=True)
    lines = [json.loads(line) for line in (one / "metrics.jsonl").read_text().splitlines()]
    assert {line["stage"] for line in lines} == {"fine"}
    assert lines[-1]["l1"] < lines[0]["l1"] / FALL
    scene = load_scene(one)
    assert scene.deformation is None and scene.moving.count == 0
    transient = scene.transient
    assert transient is not None and transient.count >= 6
    # No lifetime is below half of the interval, and colours have left grey.
    assert float(jnp.min(transient.lifetime)) >= 0.25 - 1e-3
    assert float(jnp.std(transient.harmonics)) > 0.1

    with pytest.raises(KeyboardInterrupt), toy.stopped_after(monkeypatch, "record", 4):
        reconstruct(capture, two, options=OPTIONS, quiet=True)
    reconstruct(capture, two, options=OPTIONS, resume=True, quiet=True)
    toy.same_bytes(one, two)


@pytest.fixture(scope="module")
def from_moving_cameras(tmp_path_factory, known_sizes):
    """The toy, filmed by cameras that go around it meanwhile."""
    folder, camera = tmp_path_factory.mktemp("moving"), toy.camera
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(toy, "camera", lambda angle, time: camera(angle + 0.1 * time, time))
        return read_capture(toy.write_capture(folder, toy.scene()))


@pytest.mark.ci
def test_where_cameras_move_what_stands_still_is_fitted_first(
    from_moving_cameras, tmp_path, monkeypatch
):
    asked = []

    def clouds(footage, times, *, moved, **options):
        asked.extend(moved(frame) for frame in range(len(footage.times)))
        return []

    monkeypatch.setattr(moving_clouds, "moving_points", clouds)
    options = replace(OPTIONS, fit=replace(FIT, coarse=240, fine=60))
    one, two = tmp_path / "one", tmp_path / "two"
    reconstruct(from_moving_cameras, one, options=options, quiet=True)
    lines = [json.loads(line) for line in (one / "metrics.jsonl").read_text().splitlines()]
    assert [stage for stage, _ in itertools.groupby(line["stage"] for line in lines)] == [
        "coarse",
        "fine",
    ]
    assert len(asked) == 9 and any(mask.any() for mask in asked)
    assert load_scene(one).transient is not None

    with pytest.raises(KeyboardInterrupt), toy.stopped_after(monkeypatch, "save_in_time", 8):
        reconstruct(from_moving_cameras, two, options=options, quiet=True)
    reconstruct(from_moving_cameras, two, options=options, resume=True, quiet=True)
    assert (one / "scene.npz").read_bytes() == (two / "scene.npz").read_bytes()


@pytest.mark.ci
def test_what_is_known_to_stand_still_is_fitted_to_the_pictures_of_all_times(
    from_moving_cameras, tmp_path, monkeypatch
):
    monkeypatch.setattr(moving_clouds, "moving_points", lambda *_, **__: pytest.fail("sought"))
    options = replace(OPTIONS, fit=replace(FIT, motion="none", fine=60))
    scene = reconstruct(from_moving_cameras, tmp_path, options=options, quiet=True)
    lines = [json.loads(line) for line in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    assert {line["stage"] for line in lines} == {"fine"} and lines[-1]["step"] == 60
    assert len(scene.static.mean) and not len(scene.moving.mean)
    assert scene.deformation is None and scene.transient is None
    assert lines[-1]["l1"] < lines[0]["l1"]


def test_where_stereo_finds_nothing_a_warning_says_what_to_do(capture, tmp_path, monkeypatch):
    def nothing(*arguments, **options):
        return jax.tree.map(lambda x: x[:0], on_bodies(*arguments, **options))

    monkeypatch.setattr(motion, "initial_transients", nothing)
    few = replace(OPTIONS, fit=replace(FIT, fine=20))
    with pytest.warns(CaptureWarning, match="fit.motion=deformation"):
        scene = reconstruct(capture, tmp_path, options=few, quiet=True)
    assert scene.transient is None and scene.deformation is None
    assert_allclose(scene.time_range, capture.time_range)


CONTROL = replace(OPTIONS, fit=replace(FIT, fine=60, motion="control_points"))
# Bodies of radius 0.15 are followed to a third of it.
NEAR = 0.05
# Gaussians that began on them are within two radii after some steps.
FAR = 0.3


def around_bodies(footage, times, **_):
    """Points on balls where the two bodies of the toy are at every time, others at each."""
    scene, clouds = toy.scene(), []
    for k, time in enumerate(times):
        dice = np.random.default_rng(k)
        out = dice.normal(size=(2, 150, 3))
        out /= np.linalg.norm(out, axis=-1, keepdims=True)
        center = np.asarray(at(scene, toy.single(time)).mean)[25:, None]
        position = (center + 0.15 * out).reshape(-1, 3).astype(np.float32)
        color = (0.5 + 0.4 * out).reshape(-1, 3).astype(np.float32)
        one = np.ones(len(position), np.float32)
        found = StereoPoints(position, 0 * position, color, one, one, one)
        clouds.append(MovingPoints(found, float(time), 0 * position, 3 * one))
    return clouds


@pytest.mark.ci
def test_gaussians_follow_control_points_and_an_interrupted_run_goes_on_to_the_same_bytes(
    capture, tmp_path, monkeypatch
):
    monkeypatch.setattr(moving_clouds, "moving_points", around_bodies)
    one, two = tmp_path / "one", tmp_path / "two"
    reconstruct(capture, one, options=CONTROL, quiet=True)
    scene = load_scene(one)
    assert scene.moving.count and scene.transient is not None
    control = scene.deformation.control
    # Each control point goes where its body goes.
    path = np.asarray(control.path)
    pivot, truth = np.asarray(control.pivot), toy.scene()
    first, last = (np.asarray(at(truth, toy.single(t)).mean)[25:] for t in (0.0, 1.0))
    own = np.argmin(np.linalg.norm(pivot[:, None] - first[None], axis=-1), axis=1)
    assert_allclose(np.median(path[:, -1] - (last - first)[own], axis=0), 0, atol=NEAR)

    with pytest.raises(KeyboardInterrupt), toy.stopped_after(monkeypatch, "record", 3):
        reconstruct(capture, two, options=CONTROL, quiet=True)
    reconstruct(capture, two, options=CONTROL, resume=True, quiet=True)
    toy.same_bytes(one, two)


@pytest.mark.ci
def test_where_cameras_move_gaussians_on_the_first_points_follow_control_points(
    from_moving_cameras, tmp_path, monkeypatch
):
    monkeypatch.setattr(moving_clouds, "moving_points", around_bodies)
    options = replace(CONTROL, fit=replace(CONTROL.fit, coarse=40))
    one, two = tmp_path / "one", tmp_path / "two"
    reconstruct(from_moving_cameras, one, options=options, quiet=True)
    lines = [json.loads(line) for line in (one / "metrics.jsonl").read_text().splitlines()]
    assert {line["stage"] for line in lines} == {"coarse", "fine"}
    scene = load_scene(one)
    assert scene.transient is not None and scene.deformation.control is not None
    # A quarter of all Gaussians begin on the bodies, at the first time.
    bodies = np.asarray(at(toy.scene(), toy.single(0.0)).mean)[25:]
    away = np.linalg.norm(np.asarray(scene.moving.mean)[:, None] - bodies, axis=-1).min(axis=1)
    assert scene.moving.count >= 12 and np.median(away) < FAR

    with pytest.raises(KeyboardInterrupt), toy.stopped_after(monkeypatch, "record", 4):
        reconstruct(from_moving_cameras, two, options=options, quiet=True)
    reconstruct(from_moving_cameras, two, options=options, resume=True, quiet=True)
    toy.same_bytes(one, two)


@pytest.mark.parametrize("rig", ["capture", "from_moving_cameras"])
def test_without_points_to_follow_there_is_a_field_alone(rig, request, tmp_path, monkeypatch):
    def few(footage, times, **_):
        nothing = around_bodies(footage, times)[0].points
        nothing = StereoPoints(*(x[:0] for x in nothing))
        empty = np.zeros(0, np.float32)
        return [MovingPoints(nothing, float(t), nothing.position, empty) for t in times]

    monkeypatch.setattr(moving_clouds, "moving_points", few)
    options = replace(CONTROL, fit=replace(CONTROL.fit, fine=20))
    scene = reconstruct(request.getfixturevalue(rig), tmp_path, options=options, quiet=True)
    assert scene.deformation is None or scene.deformation.control is None
