"""Sketches are pictures, made by programs that no slider compiles anew."""

import os
import subprocess
import sys
import time as clock
from pathlib import Path

import numpy as np
import pytest
import rooms

from gaussray.camera.sensor.sensor import SensorOptions
from gaussray.render import picture_programs
from gaussray.render.aov.labeller import Labeller
from gaussray.render.develop import picture_levels
from gaussray.render.renderer import Renderer
from gaussray.tracer.traverse import Capacity
from gaussray.viewer import preview
from gaussray.viewer.controls import choice_values
from gaussray.viewer.develop import develop_preview
from gaussray.viewer.focus import clicked_focus_distance
from gaussray.viewer.preview import PreviewRenderer


pytestmark = pytest.mark.usefixtures("known_sizes")

# Programs of other lengths of lists add in another order: single precision.
SINGLE = 1e-5


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return rooms.viewer_model(rooms.write_scene(tmp_path_factory.mktemp("run")))


@pytest.fixture(scope="module")
def previewer(model):
    job = model.job(model.initial_values, model.initial_viewpoint, model.size)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(preview, "staged_capacity", lambda *_: rooms.ROOM)
        yield PreviewRenderer(model.scene, options=job.options, trace=job.trace, keys=3)


def job_with(model, **changes):
    values = model.initial_values | {
        key.replace("__", "."): value for key, value in changes.items()
    }
    return model.job(values, model.initial_viewpoint, model.size)


def test_a_preview_is_the_picture_that_is_rendered(model, previewer):
    job = job_with(model, aperture__radius=0.2, aperture__focus_distance=3.0)
    camera = job.records[0].camera
    found = rooms.made(previewer, camera, job.options.samples)
    frame = Renderer(model.scene, options=job.options, trace=job.trace)(camera)
    values = np.asarray(found.values).reshape(16, 16, 5)
    assert frame.color.std() > 0.05
    np.testing.assert_allclose(values[..., :3], frame.color, atol=SINGLE)
    np.testing.assert_allclose(values[..., 3], frame.alpha, atol=SINGLE)
    assert found.dropped == 0 and found.hits == frame.hits
    codes = picture_levels(job.records[0], frame.color, job.dataset.sensor).astype(int)
    assert np.abs(develop_preview(found, job).astype(int) - codes).max() <= 1


def test_no_slider_compiles_anything(model, previewer):
    rooms.made(previewer, job_with(model, aperture__radius=0.2).records[0].camera, 2)
    for change in (
        {"lens__fov": 40.0},
        {"aperture__radius": 0.05},
        {"aperture__focus_distance": 1.5},
        {"aperture__rotation": 1.0},
    ):
        job = job_with(model, **({"aperture__radius": 0.2} | change))
        assert previewer(job.records[0].camera, 2) is not None
    viewpoint = model.initial_viewpoint._replace(time=0.3, position=(0.1, 0.2, -3.0))
    job = model.job(model.initial_values | {"aperture.radius": 0.1}, viewpoint, model.size)
    assert previewer(job.records[0].camera, 2) is not None
    assert previewer.compiling == 0


def test_another_lens_compiles_only_its_rays(model, previewer, monkeypatch):
    rooms.made(previewer, job_with(model).records[0].camera, 1)
    made, make = [], picture_programs.on_devices

    def noted(function, *arguments, **options):
        made.append(function.__qualname__.split(".")[0])
        return make(function, *arguments, **options)

    monkeypatch.setattr(picture_programs, "on_devices", noted)
    values = model.initial_values | choice_values("lens", "equisolid")
    camera = model.job(values, model.initial_viewpoint, model.size).records[0].camera
    assert not previewer.has(camera, 1)
    rooms.made(previewer, camera, 1)
    assert made == ["camera_program"]


def test_lists_are_measured_where_nothing_is_known(model):
    job = job_with(model)
    one = PreviewRenderer(model.scene, options=job.options, trace=job.trace, keys=3)
    camera = job.records[0].camera
    found = rooms.made(one, camera, 1)
    assert found.dropped == 0 and found.hits > 0
    one.close()


def test_readout_and_exposure_share_a_program_which_no_single_instant_needs(model, previewer):
    cameras = [
        job_with(model, shutter__kind="rolling", **times).records[0].camera
        for times in (
            {"shutter__readout": 0.1},
            {"shutter__readout": 0.9, "shutter__exposure": 0.2},
        )
    ]
    rooms.made(previewer, job_with(model).records[0].camera, 1)
    assert not any(previewer.has(camera, 1) for camera in cameras)
    rooms.made(previewer, cameras[0], 1)
    assert all(previewer.has(camera, 1) for camera in cameras)


@pytest.mark.slow
def test_lists_that_are_too_short_are_told_of_and_lengthened(model, previewer, monkeypatch):
    job = job_with(model)
    one = PreviewRenderer(model.scene, options=job.options, trace=job.trace, keys=3)
    monkeypatch.setattr(preview, "staged_capacity", lambda *_: Capacity((64,), 16, 8))
    camera = job.records[0].camera
    first = rooms.made(one, camera, 1)
    assert first.dropped > 0
    until = clock.monotonic() + 120
    while (one(camera, 1).dropped or one.compiling) and clock.monotonic() < until:
        clock.sleep(0.01)
    assert one(camera, 1).dropped == 0 and one.compiling == 0
    one.close()


def test_the_focus_is_on_what_is_under_the_mouse(model, previewer):
    job = job_with(model, aperture__radius=0.2)
    camera = job.records[0].camera
    labels = Labeller(model.scene, options=job.options, trace=job.trace)(camera, ["z", "alpha"])
    seen = np.argwhere(labels["alpha"] > 0.6)
    row, column = seen[len(seen) // 2]
    found = clicked_focus_distance(previewer, camera, (int(column), int(row)))
    assert found == pytest.approx(labels["z"][row, column], rel=1e-4)


def test_where_nothing_is_seen_there_is_no_focus(model, previewer):
    away = model.initial_viewpoint._replace(position=(0.0, 0.0, 50.0))
    camera = model.job(model.initial_values, away, model.size).records[0].camera
    assert clicked_focus_distance(previewer, camera, (8, 8)) is None


def test_a_sensor_develops_a_preview_as_a_picture(model, previewer):
    values = model.initial_values | choice_values("sensor", "filmic") | {"aperture.radius": 0.2}
    job = model.job(values, model.initial_viewpoint, model.size)
    assert job.dataset.sensor != SensorOptions()
    found = rooms.made(previewer, job.records[0].camera, 2)
    light = np.asarray(found.values)[:, :3].reshape(16, 16, 3)
    codes = picture_levels(job.records[0], light, job.dataset.sensor).astype(int)
    assert codes.std() > 5
    assert np.abs(develop_preview(found, job).astype(int) - codes).max() <= 1


@pytest.mark.ci
def test_two_cores_share_a_preview(tmp_path):
    # A process has its devices for life.
    here = Path(__file__).parent
    env = os.environ | {"JAX_NUM_CPU_DEVICES": "2", "JAX_PLATFORMS": "cpu"}
    path = [str(here), str(here.parent), str(here.parents[1]), env.get("PYTHONPATH", "")]
    env["PYTHONPATH"] = os.pathsep.join(filter(None, path))
    words = [sys.executable, str(here / "two_cores.py"), str(tmp_path)]
    done = subprocess.run(words, env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["the", "same"]
