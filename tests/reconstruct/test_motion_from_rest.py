"""fit.motion=from_rest of pictures that each have a time of their own: control points that begin
at rest learn how things move."""

from dataclasses import replace

import numpy as np
import pytest
import toy

from gaussray.capture.formats.paired import read_capture
from gaussray.reconstruct import session
from gaussray.reconstruct.log import RunLog
from gaussray.reconstruct.options import FitOptions
from gaussray.reconstruct.pipeline import reconstruct
from gaussray.reconstruct.run_progress import StageSchedule
from gaussray.reconstruct.session import Session
from gaussray.reconstruct.step_plan import StepPlan
from gaussray.scene.store import load_scene


TIMES = tuple(np.linspace(0.0, 1.0, 25).tolist())
FIT = FitOptions(
    auto=False, coarse=100, fine=1000, tiles=4, block=20, points=27, surround=0.0,
    start="given", motion="from_rest",
)  # fmt: skip
# Of its way, a body is followed from end to end at least so far; the rest is the fit's error.
SHARE = 0.6
SPEED = 0.8


@pytest.fixture(scope="module")
def capture(tmp_path_factory, known_sizes):
    """Two bodies on their way along +x, filmed from another place at every time."""
    folder, camera = tmp_path_factory.mktemp("jumping"), toy.camera
    places = dict(zip(TIMES, np.random.default_rng(0).uniform(-0.8, 0.8, len(TIMES)), strict=True))
    records = toy.records
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(toy, "camera", lambda _, time: camera(places[time], time))
        patch.setattr(toy, "records", lambda times: records(times, cameras=("cam_0",)))
        return read_capture(
            toy.write_capture(folder, toy.carried(0.0, 1.0, speed=SPEED), times=TIMES)
        )


@pytest.mark.ci
def test_control_points_on_what_moves_go_where_it_goes(capture, tmp_path):
    reconstruct(capture, tmp_path, options=replace(toy.SHORT, fit=FIT), quiet=True)
    scene = load_scene(tmp_path)
    control = scene.deformation.control
    assert scene.static.count == 0 and control.path.shape[1] == 10
    way = np.asarray(control.path[:, -1] - control.path[:, 0])
    before = np.asarray(control.pivot)[:, 2] < 0.4
    assert np.median(way[before, 0]) > SHARE * SPEED
    assert np.abs(np.median(way[~before], axis=0)).max() < 0.2 * SPEED


class LookedAt(Exception):
    """Raised where the first points are asked for, so that nothing is fitted."""


@pytest.mark.parametrize(("taken", "first"), [(("cam_0",), 6), (("cam_0", "cam_1"), 0)])
def test_first_points_are_those_of_a_short_while(capture, tmp_path, monkeypatch, taken, first):
    """Around the middle; or from the first time on, if two pictures of it tell where things are."""
    views = [replace(v, camera_name=name) for name in taken for v in capture.views]
    seen = []

    def asked(capture, footage, *_):
        seen.extend(np.unique(footage.times).tolist())
        raise LookedAt

    monkeypatch.setattr(session, "initial_points", asked)
    options = replace(toy.SHORT, fit=replace(FIT, window=0.5))
    with pytest.raises(LookedAt):
        reconstruct(replace(capture, views=views), tmp_path, options=options, quiet=True)
    want = np.float32(TIMES[first : first + 13])
    np.testing.assert_allclose(seen, want, rtol=1e-6)


@pytest.mark.ci
def test_an_interrupted_run_goes_on_to_the_same_bytes(capture, tmp_path, monkeypatch):
    short = replace(FIT, coarse=20, fine=60, checkpoint=0.0)
    options, one, two = replace(toy.SHORT, fit=short), tmp_path / "one", tmp_path / "two"
    reconstruct(capture, one, options=options, quiet=True)
    with pytest.raises(KeyboardInterrupt), toy.stopped_after(monkeypatch, "record", 3):
        reconstruct(capture, two, options=options, quiet=True)
    reconstruct(capture, two, options=options, resume=True, quiet=True)
    toy.same_bytes(one, two)


@pytest.mark.parametrize("cut", [False, True])
def test_all_times_are_seen_in_the_last_steps_also_of_a_plan_that_is_cut(capture, tmp_path, cut):
    log = RunLog(tmp_path, resume=False, interval=0.0)
    loader = Session(capture, log, replace(toy.SHORT, fit=FIT), quiet=True).loader
    plan, width = StepPlan(StageSchedule(200)), []
    for done, batches in loader.blocks("fine", 0, plan, 20):
        width.append(np.ptp(batches.time))
        if cut and done == 20:
            plan.schedule = StageSchedule(100)
        if done + 20 >= plan.steps:
            break
    assert len(width) == (5 if cut else 10)
    grown = 6 * len(loader.sampler.times)
    seen = [loader.sees_all("fine", n, n / (10 * grown)) for n in (0, grown - 10, grown)]
    assert seen == [False, False, True]
    # At first half of the times; in the end all, of which 20 steps draw some.
    assert width[0] <= 0.5 and width[-1] > 0.7


def test_a_plan_that_is_made_anew_sees_all_times_from_then_on(capture, tmp_path):
    log = RunLog(tmp_path, resume=False, interval=0.0)
    loader = Session(capture, log, replace(toy.SHORT, fit=FIT), quiet=True).loader
    # So short that its share decides when all times are seen.
    assert not loader.sees_all("fine", 11, StageSchedule(20).share_at(11))
    assert loader.sees_all("fine", 12, StageSchedule(20).share_at(12))
    again = StageSchedule(1000, 12, 0.6)
    assert loader.sees_all("fine", 12, again.share_at(12))
    assert loader.sees_all("fine", 13, again.share_at(13))
