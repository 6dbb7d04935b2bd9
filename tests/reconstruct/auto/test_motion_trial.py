"""Which of several ways shows what moves best is told by pictures that are held out."""

import json
import threading
from dataclasses import replace

import numpy as np
import pytest
import toy

from gaussray.capture.formats.paired import read_capture
from gaussray.capture.temporal_median import differs
from gaussray.reconstruct import pipeline, plan, segment_fit
from gaussray.reconstruct.auto import choice, machine, motion_choice, motion_trial
from gaussray.reconstruct.auto.motion_choice import with_motion_tried
from gaussray.reconstruct.auto.motion_trial import (
    motion_tiles,
    motion_trial_scores,
    moving_alone,
    moving_score,
    trial_sentence,
)
from gaussray.reconstruct.auto.trial_fits import TrialFits
from gaussray.reconstruct.data.held_out_tiles import trial_tiles
from gaussray.reconstruct.data.motion_mask import activity
from gaussray.reconstruct.data.pictures import footage
from gaussray.reconstruct.data.segments import segments, training_views
from gaussray.reconstruct.log import NonFiniteLoss
from gaussray.reconstruct.optimize.optimizer import Parameters
from gaussray.reconstruct.optimize.state import begin_state
from gaussray.reconstruct.options import FitOptions, ReconstructOptions
from gaussray.reconstruct.pipeline import reconstruct
from gaussray.reconstruct.shared_results import SharedResults
from gaussray.scene.deformation import Deformation
from gaussray.scene.gaussians import unconstrain


pytestmark = pytest.mark.usefixtures("known_sizes")

TIMES = tuple(np.linspace(0, 1, 9).tolist())


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    folder = tmp_path_factory.mktemp("capture")
    return read_capture(toy.write_capture(folder, toy.scene(), times=TIMES))


def seen(views, side=8):
    return footage(views, side=side, bundle=8)


def fits_of(capture, out, fitted, shared=None, at_once=False):
    part = segments(capture, 0)[0]
    shared = shared or SharedResults()
    return TrialFits(capture, part, out, fitted, shared, at_once=at_once)


def test_of_five_cameras_one_is_held_out_at_each_time(capture):
    train = training_views(capture)
    own = [view for view in train if view.camera_name == train[0].camera_name]
    views = [replace(view, camera_name=name) for name in "abcde" for view in own]
    pictures = seen(views)
    held = motion_tiles(pictures, 0.0, 0)
    # Whole pictures alone.
    assert (held.all(axis=1) == held.any(axis=1)).all()
    names = {float(pictures.times[k]): str(pictures.name[k]) for k in np.flatnonzero(held[:, 0])}
    assert [names[time] for time in sorted(names)] == list("abdeabdea")
    assert held[:, 0].sum() == 9


def test_of_few_cameras_a_quarter_of_each_picture_is_held_out(capture):
    views, shares = training_views(capture), []
    for seed in range(40):
        held = motion_tiles(seen(views), 0.0, seed)
        np.testing.assert_array_equal(held, motion_tiles(seen(views), 0.0, seed))
        shares.append(held.mean())
    # The pictures are smaller than a square: each of them is held out or not.
    assert held.all(axis=1).any() and not held.all()
    # The mean of 40 draws of 18 pictures has a standard deviation of 0.02.
    assert abs(np.mean(shares) - 0.25) < 0.06


def test_a_tile_is_held_out_that_any_square_covers(capture, monkeypatch):
    monkeypatch.setattr(motion_trial, "_SQUARE", 8)
    views = training_views(capture)[:4]
    small, large = (motion_tiles(seen(views, side), 0.0, 1) for side in (8, 16))
    assert small.any() and not small.all()
    np.testing.assert_array_equal(small.any(axis=1), large[:, 0])


def test_what_is_masked_is_not_held_out(capture):
    pictures = seen(training_views(capture))
    mask = np.full((*pictures.pixel.shape[:2], 8), 255, np.uint8)
    mask[:, 0] = 0
    assert not motion_tiles(replace(pictures, mask=mask), 0.0, 0)[:, 0].any()


@pytest.mark.ci
def test_a_fit_is_scored_on_moving_pixels_that_no_step_draws_and_a_failed_one_loses(
    capture, tmp_path
):
    tried, scene = [], toy.scene()
    steps = {"deformation": 700, "transient": 600, "both": 500}
    # Alone, what moves is in its place at the first time.
    wrong = replace(scene, moving=scene.static)

    def fitted(session, state, progress):
        tried.append(session.options.fit.motion)
        assert state is None and session.options.fit.fine == steps[tried[-1]]
        expected = motion_tiles(session.footage, 0.0, session.options.fit.seed)
        np.testing.assert_array_equal(session.held_out, expected)
        drawn = session.loader.batches("fine", 0, 20)
        assert not expected[np.asarray(drawn.frame), np.asarray(drawn.tile)].any()
        if len(tried) == 3:
            raise NonFiniteLoss("nothing")
        shown = scene if len(tried) == 1 else wrong
        field = shown.deformation
        assert isinstance(field, Deformation)
        parts = unconstrain(shown.static), unconstrain(shown.moving), field
        return begin_state(Parameters(*parts, None)), progress

    names = ("deformation", "transient", "both")
    candidates = {
        name: replace(toy.SHORT, fit=replace(toy.SHORT.fit, motion=name)) for name in names
    }
    scores = motion_trial_scores(fits_of(capture, tmp_path, fitted), candidates, steps.__getitem__)
    assert tried == list(names)
    # Pictures of 8 bits of the scene itself.
    assert scores["deformation"] > 40 > scores["transient"] > scores["both"] == 0
    assert not list(tmp_path.glob("trial*"))
    line = trial_sentence(scores, choice.MOTION_NOUNS)
    assert "fit.motion=deformation" in line and "transient Gaussians" in line


def test_fits_of_a_trial_run_at_once_where_the_machine_has_room(capture, tmp_path):
    meeting = threading.Barrier(2, timeout=60)

    def fitted(session, state, progress):
        side = session.options.fit.tile_side
        # Each has pictures in tiles of its own size, and its own folder.
        assert session.footage.side == side
        session.shared.once("points", lambda: found.append(side))
        (session.log.out / "own").write_text(str(side))
        meeting.wait()
        assert (session.log.out / "own").read_text() == str(side)
        parts = unconstrain(scene.static), unconstrain(scene.moving), scene.deformation
        return begin_state(Parameters(*parts, None)), progress

    found, scene = [], toy.scene()
    candidates = {
        name: replace(toy.SHORT, fit=replace(toy.SHORT.fit, tile_side=side))
        for name, side in (("control_points", 16), ("deformation", 8))
    }
    fits = fits_of(capture, tmp_path, fitted, at_once=True)
    scores = motion_trial_scores(fits, candidates, lambda _: 20)
    assert list(scores) == list(candidates) and min(scores.values()) > 40
    assert len(found) == 1
    assert not list(tmp_path.glob("trial*"))


def test_where_no_tile_can_be_held_out_nothing_is_tried(capture, tmp_path, monkeypatch):
    monkeypatch.setattr(
        motion_trial, "motion_tiles", lambda seen, *_: np.zeros(seen.pixel.shape[:2], bool)
    )
    fits = fits_of(capture, tmp_path, lambda *_: pytest.fail("fitted"))
    assert motion_trial_scores(fits, {"deformation": toy.SHORT}, lambda _: 20) == {}
    assert not list(tmp_path.glob("trial*"))


def test_only_pixels_that_differ_from_the_temporal_median_count(capture):
    train = training_views(capture)
    one = [view for view in train if view.camera_name == train[0].camera_name]
    pictures = seen(one)
    levels = pictures.pictures(np.arange(len(one)))
    moving = differs(levels, np.median(levels, axis=0), 255)
    assert 0 < moving.mean() < 0.5
    alone = moving_alone(pictures, activity(pictures))
    np.testing.assert_array_equal(alone.masks(np.arange(len(one))), moving)
    # What is masked does not count even if it moves.
    hidden = replace(pictures, mask=np.zeros((*pictures.pixel.shape[:2], 8), np.uint8))
    alone = moving_alone(hidden, activity(pictures)).visible(slice(None), slice(None))
    assert alone is not None and not alone.any()


def test_the_better_one_is_fitted_and_a_resumed_run_does_not_try_again(
    capture, tmp_path, monkeypatch
):
    def tried(resume):
        fits = fits_of(capture, tmp_path, lambda *_: pytest.fail("fitted"))
        return with_motion_tried(
            fits, usual, candidates, steps=lambda _: 20, resume=resume, say=said.append
        )

    said, names = [], ("deformation", "transient")
    usual = choice.AutoChoice(capture, toy.SHORT, "")
    candidates = {name: choice.AutoChoice(capture, toy.SHORT, name) for name in names}
    monkeypatch.setattr(
        motion_choice, "motion_trial_scores", lambda *_: {"deformation": 20.0, "transient": 21.0}
    )
    chosen, scores = tried(False)
    assert chosen is candidates["transient"] and scores["transient"] == 21.0
    assert json.loads((tmp_path / "motion.json").read_text()) == scores
    assert "fit.motion=transient" in said[-1]
    monkeypatch.setattr(motion_choice, "motion_trial_scores", lambda *_: pytest.fail("tried again"))
    assert tried(True) == (chosen, scores)
    # Nothing is tried where the user chose, and nothing is left for a run to be resumed by.
    candidates = {}
    assert tried(False) == (usual, {}) and not (tmp_path / "motion.json").exists()
    assert tried(True) == (usual, {})


@pytest.mark.parametrize("best", ["deformation", "transient"])
def test_a_trial_compares_the_smallest_pictures_and_the_fit_has_its_own(
    capture, tmp_path, monkeypatch, best
):
    """On a CPU, transient Gaussians are fitted to smaller pictures than rigid bodies."""
    monkeypatch.setattr(machine, "_PIXELS_TRANSIENT", 2000.0)
    width, seen = training_views(capture)[0].width, {}

    class Fitted(Exception):
        pass

    def tried(fits, chosen, candidates, **_):
        seen["trial"] = fits.capture.views[0].width
        return candidates[best], {}

    def fitted(session, state, progress):
        seen["fit"] = session.footage.film.width
        raise Fitted

    monkeypatch.setattr(plan, "with_motion_tried", tried)
    monkeypatch.setattr(pipeline, "fitted_state", fitted)
    options = ReconstructOptions(fit=FitOptions(points=20))
    killed = tmp_path / "trial_of_both"
    killed.mkdir()
    (killed / "metrics.jsonl").write_text("{}")
    with pytest.raises(Fitted):
        reconstruct(capture, tmp_path, options=options, quiet=True)
    assert not killed.exists()
    assert seen["trial"] < width
    assert seen["fit"] == (width if best == "deformation" else seen["trial"])


@pytest.mark.slow
def test_fits_that_share_results_are_the_same_as_alone(capture, tmp_path):
    """Points, bodies and sizes are found once, and the second fit ends with the same numbers."""

    def scored(shared, name):
        fits = fits_of(capture, tmp_path / name, segment_fit.fitted_state, shared)
        return fits.score(name, options, trial_tiles, measure)

    def measure(session, state):
        ends.append(np.asarray(state.parameters.static.mean))
        return moving_score(session, state)

    fit = replace(toy.SHORT.fit, validate=0.5, coarse=10, fine=10)
    options, ends = replace(toy.SHORT, fit=fit), []
    shared = SharedResults()
    scores = [scored(shared, "a"), scored(shared, "b"), scored(SharedResults(), "c")]
    assert scores[0] == scores[1] == scores[2] != 0
    for other in ends[1:]:
        np.testing.assert_array_equal(ends[0], other)
