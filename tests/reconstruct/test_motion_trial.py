"""Which of several ways shows what moves best is told by pictures that are held out."""

import json
from dataclasses import replace

import numpy as np
import pytest
import toy

from gaussray.capture.formats.paired import read_capture
from gaussray.capture.temporal_median import moving_mask
from gaussray.reconstruct import effort, motion_trial, pipeline
from gaussray.reconstruct.data.pictures import footage
from gaussray.reconstruct.failed_fit import FailedFit
from gaussray.reconstruct.motion_trial import (
    held_out_capture,
    moving_alone,
    trial,
    trial_sentence,
)


pytestmark = pytest.mark.usefixtures("known_sizes")

AUTO = replace(toy.SHORT, fit=replace(toy.SHORT.fit, auto=True, points=20))
RIVALS = {"deformation": toy.SHORT, "transient": toy.SHORT}


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    times = tuple(np.linspace(0, 1, 9).tolist())
    folder = tmp_path_factory.mktemp("capture")
    return read_capture(toy.write_capture(folder, toy.scene(), times=times))


def test_of_five_cameras_one_is_held_out_at_each_time_of_fewer_every_fourth_time(capture):
    train = [view for view in capture.views if view.split == "train"]
    few = held_out_capture(capture)
    assert {v.time for v in few.views if v.split == "test"} == {0.25, 0.75}
    assert len(few.views) == len(train)
    five = [replace(v, camera_name=name) for name in "abcde" for v in train[:9]]
    many = held_out_capture(replace(capture, views=five))
    held = {v.time: v.camera_name for v in many.views if v.split == "test"}
    assert [held[time] for time in sorted(held)] == list("abdeabdea")
    assert sum(v.split == "test" for v in many.views) == 9
    short = [v for v in train if v.time < 0.5]
    assert held_out_capture(replace(capture, views=short)) is None


@pytest.mark.ci
def test_a_scene_is_scored_on_what_is_held_out_and_a_failed_fit_loses(capture, tmp_path):
    part, fits = held_out_capture(capture), []

    def fit(given, folder, options):
        assert given is part and options.fit.fine == motion_trial._STEPS
        fits.append(folder)
        if len(fits) == 3:
            raise FailedFit("nothing")
        scene = toy.scene()
        return scene if len(fits) == 1 else replace(scene, static=scene.moving)

    scores = trial(part, tmp_path, {**RIVALS, "both": toy.SHORT}, fit, None)
    # Pictures of 8 bits of the scene itself.
    assert scores["deformation"] > 40 > scores["transient"] > scores["both"] == 0
    assert not (tmp_path / "trial").exists()
    line = trial_sentence(scores, effort.MOTION_NOUNS)
    assert "fit.motion=deformation" in line and "transient Gaussians" in line


def test_only_pixels_that_differ_from_the_temporal_median_count(capture):
    train = [view for view in capture.views if view.split == "train"]
    one = [view for view in train if view.camera_name == train[0].camera_name]
    seen = footage(one, side=8, bundle=8)
    moving = moving_mask(seen.pictures(np.arange(len(one))) / np.float32(255))
    assert 0 < moving.mean() < 0.5
    np.testing.assert_array_equal(moving_alone(seen).masks(np.arange(len(one))), moving)
    # What is masked does not count even if it moves.
    hidden = moving_alone(replace(seen, mask=np.zeros((*seen.pixel.shape[:2], 8), np.uint8)))
    assert not hidden.visible(slice(None), slice(None)).any()


def test_the_better_one_is_fitted_and_a_resumed_run_does_not_try_again(
    capture, tmp_path, monkeypatch
):
    monkeypatch.setattr(pipeline, "this_machine", lambda: effort.Machine(gpu=True))
    monkeypatch.setattr(pipeline, "trial", lambda *_: {"deformation": 20.0, "transient": 21.0})
    known = capture, tmp_path, AUTO
    chosen, scores = pipeline._with_motion_tried(*known, False, None, True)
    assert chosen.fit.motion == "transient" and scores["transient"] == 21.0
    assert json.loads((tmp_path / "motion.json").read_text()) == scores
    monkeypatch.setattr(pipeline, "trial", lambda *_: pytest.fail("tried again"))
    assert pipeline._with_motion_tried(*known, True, None, True) == (chosen, scores)
    # Nothing is tried where the user chose, and nothing is left for a run to be resumed by.
    same, none = pipeline._with_motion_tried(capture, tmp_path, chosen, False, None, True)
    assert same == chosen and not none and not (tmp_path / "motion.json").exists()
    assert pipeline._with_motion_tried(*known, True, None, True) == (AUTO, {})
