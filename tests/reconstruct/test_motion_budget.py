"""What moves gets no more Gaussians than its pixels can tell apart."""

from dataclasses import replace

import numpy as np
import pytest
import toy

from gaussray.capture.formats.paired import read_capture
from gaussray.reconstruct import motion, motion_budget as module
from gaussray.reconstruct.data.segments import segments
from gaussray.reconstruct.initialize.stereo.from_pictures import MovingPoints
from gaussray.reconstruct.initialize.stereo.points import StereoPoints
from gaussray.reconstruct.log import RunLog
from gaussray.reconstruct.motion_budget import MotionBudget, motion_budget
from gaussray.reconstruct.optimize.density import DensityOptions
from gaussray.reconstruct.optimize.rows import occupied
from gaussray.reconstruct.session import Session


MOST = 500_000


def session(capture, folder, **fit):
    options = replace(
        toy.SHORT,
        fit=replace(toy.SHORT.fit, **{"motion": "control_points", **fit}),
        density=DensityOptions(kind="relocate", interval=100, gaussians=MOST),
    )
    log = RunLog(folder, resume=False, interval=1e9, writes=False, listener=None)
    return Session(capture, log, options, True, segment=segments(capture, 0)[0])


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    return read_capture(toy.write_capture(tmp_path_factory.mktemp("capture"), toy.scene()))


def test_the_budget_is_a_share_of_the_pixels_that_move(capture, tmp_path, monkeypatch):
    one = session(capture, tmp_path)
    pixels, times = int(one.activity.moved.sum(dtype=int)), len(one.times)
    assert pixels > 100
    # Pictures this small hardly show anything, but a scene is not made of a hundred Gaussians.
    assert motion_budget(one, None) == (module._FEWEST, module._FEWEST)
    monkeypatch.setattr(module, "_FEWEST", 1)
    assert motion_budget(one, None) == (pixels // times, pixels // 4)
    # Where cameras move, other counts tell; never more than the whole budget.
    moved = np.full_like(one.activity.moved, 3)
    counted = int(moved.sum(dtype=int))
    assert motion_budget(one, moved) == (counted // times, counted // 4)
    many = np.full_like(one.activity.moved, 65535)
    assert motion_budget(one, many).transient == MOST


def test_pictures_that_are_alone_at_their_viewpoint_say_nothing(capture, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "_FEWEST", 1)
    one = session(capture, tmp_path)
    whole = motion_budget(one, None)
    # One camera moves: its pictures count as the others do.
    places = np.array(one.footage.viewpoints, dtype=object)
    first = one.footage.name == one.footage.name[0]
    places[first] = [f"{name} {i}" for i, name in enumerate(places[first])]
    monkeypatch.setattr(type(one.footage), "viewpoints", property(lambda _: places.astype(str)))
    told = one.activity.moved[~first].sum(dtype=int) * len(first) / (~first).sum()
    assert motion_budget(one, None).transient == int(told) // 4
    assert abs(motion_budget(one, None).transient - whole.transient) < whole.transient


def test_without_what_tells_there_is_no_budget_of_its_own(capture, tmp_path):
    assert motion_budget(session(capture, tmp_path, motion="from_rest"), None) == (MOST, MOST)


def test_transient_gaussians_begin_with_half_of_their_budget(capture, tmp_path, monkeypatch):
    monkeypatch.setattr(motion, "motion_budget", lambda *_: MotionBudget(64, 64))
    place = np.random.default_rng(1).normal(size=(60, 3)).astype(np.float32)
    one = np.ones(60, np.float32)
    points = StereoPoints(place, np.zeros_like(place), np.full_like(place, 0.5), one, one, one)
    fit = session(capture, tmp_path)
    clouds = [MovingPoints(points, float(t), np.zeros_like(place), one) for t in fit.times[:2]]
    found = motion.first_transients(fit, clouds, None)
    assert len(found.mean) == 64 and int(occupied(found).sum()) == 32
