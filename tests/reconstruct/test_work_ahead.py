"""While the coarse stage is fitted, threads find what moves and compile the fine one's steps."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.capture.formats.paired import read_capture
from gaussray.reconstruct import motion, moving_clouds, moving_control, step, work_ahead
from gaussray.reconstruct.data.segments import segments
from gaussray.reconstruct.initialize.nonrigid_registration import registration_options
from gaussray.reconstruct.initialize.stereo.from_pictures import MovingPoints
from gaussray.reconstruct.initialize.stereo.points import StereoPoints
from gaussray.reconstruct.log import RunLog
from gaussray.reconstruct.optimize.density import DensityOptions
from gaussray.reconstruct.pipeline import reconstruct
from gaussray.reconstruct.run_progress import RunProgress
from gaussray.reconstruct.session import Session
from gaussray.reconstruct.start import initial_state


pytestmark = pytest.mark.usefixtures("known_sizes")

OPTIONS = replace(
    toy.SHORT,
    fit=replace(toy.SHORT.fit, motion="control_points", coarse=10, fine=20, instants=3),
    density=DensityOptions(kind="relocate", interval=100, opacity=0.005, gaussians=256),
)


def clouds(_, times, **__):
    """Points about the bodies of the toy, which do not move."""
    place = np.random.default_rng(1).normal(size=(10, 3)).astype(np.float32) * 0.3
    one = np.ones(10, np.float32)
    points = StereoPoints(place, np.zeros_like(place), np.full_like(place, 0.5), one, one, one)
    return [MovingPoints(points, time, np.zeros_like(place), one) for time in times]


@pytest.fixture(scope="module")
def capture(tmp_path_factory, known_sizes):
    return read_capture(toy.write_capture(tmp_path_factory.mktemp("capture"), toy.scene()))


@pytest.fixture(autouse=True)
def found(monkeypatch):
    """Stereo and tracking that find three control points, as many as are guessed."""
    three = replace(registration_options("cpu"), control=3)
    monkeypatch.setattr(moving_clouds, "moving_points", clouds)
    monkeypatch.setattr(moving_control, "tracked_surface", lambda *_, **__: toy.control_points())
    monkeypatch.setattr(work_ahead, "registration_options", lambda _: three)
    monkeypatch.setattr(work_ahead, "works_ahead", lambda _: True)


def waits(monkeypatch, count):
    """What is counted each time that the program alone has been waited for."""
    seen, wait = [], work_ahead.wait

    def waited(works, **how):
        wait(works, **how)
        if len(works) == 1:
            seen.append(count())

    monkeypatch.setattr(work_ahead, "wait", waited)
    return seen


@pytest.mark.ci
def test_the_fine_stage_runs_the_program_that_was_compiled_ahead(capture, tmp_path, monkeypatch):
    traced, loss = [], step.loss_of
    monkeypatch.setattr(
        step, "loss_of", lambda *args, **kwargs: (traced.append(1), loss(*args, **kwargs))[1]
    )
    waited = waits(monkeypatch, lambda: len(traced))
    jax.clear_caches()
    reconstruct(capture, tmp_path / "ahead", options=OPTIONS, quiet=True)
    assert waited == [len(traced)] and traced
    # And nothing else changes.
    monkeypatch.setattr(work_ahead, "works_ahead", lambda _: False)
    reconstruct(capture, tmp_path / "alone", options=OPTIONS, quiet=True)
    assert len(waited) == 1
    toy.same_bytes(tmp_path / "ahead", tmp_path / "alone")


@pytest.mark.ci
def test_nobody_waits_for_a_program_of_other_shapes(capture, tmp_path, monkeypatch):
    four = replace(registration_options("cpu"), control=4)
    monkeypatch.setattr(work_ahead, "registration_options", lambda _: four)
    waited = waits(monkeypatch, lambda: 0)
    reconstruct(capture, tmp_path, options=OPTIONS, quiet=True)
    assert not waited


@pytest.mark.ci
def test_what_fails_ahead_is_told_where_it_is_needed(capture, tmp_path, monkeypatch):
    def failing(*_, **__):
        raise ValueError("no points today")

    monkeypatch.setattr(moving_clouds, "moving_points", failing)
    with pytest.raises(ValueError, match="no points today"):
        reconstruct(capture, tmp_path, options=OPTIONS, quiet=True)


def test_what_stands_in_has_the_shapes_of_the_fine_stage(capture, tmp_path):
    log = RunLog(tmp_path, resume=False, interval=1e9, writes=False, listener=None)
    session = Session(capture, log, OPTIONS, True, segment=segments(capture, 0)[0])
    state, progress = initial_state(session, RunProgress())
    guess = work_ahead.stand_in_state(session, state, progress)
    real, _ = motion.with_motion(session, state, progress)
    assert work_ahead.shapes(guess) == work_ahead.shapes(real) != work_ahead.shapes(state)
    # Of a fit that shares its results, nothing is begun again.
    with work_ahead.work_ahead(session, state, progress) as ready:
        ready(state)
    known = session.shared.known(("ahead", "control_points", ()))
    assert known
    assert jnp.all(real.parameters.static.mean == guess.parameters.static.mean)
