"""A trial of a long capture sees successive times at which much moves."""

from dataclasses import replace

import numpy as np
import pytest
import toy

from gaussray.capture.formats.paired import read_capture
from gaussray.dataset.images import write_image
from gaussray.reconstruct import pipeline, plan
from gaussray.reconstruct.auto import choice, trial_part
from gaussray.reconstruct.options import FitOptions, ReconstructOptions
from gaussray.reconstruct.pipeline import reconstruct


pytestmark = pytest.mark.usefixtures("known_sizes")

# Numbers that a file keeps as they are.
TIMES = tuple(k / 16 for k in range(13))


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    """Thirteen times, of which those from the eighth to the tenth are each another picture."""
    folder = tmp_path_factory.mktemp("capture")
    read = read_capture(toy.write_capture(folder, toy.scene(), times=TIMES))
    still = np.full((toy.SIZE, toy.SIZE, 3), 0.2, np.float32)
    for view in read.views:
        index = TIMES.index(view.time)
        write_image(view.image, still + 0.1 * (index - 6) * (7 <= index <= 9))
    return read


@pytest.fixture(autouse=True)
def few_times(monkeypatch):
    monkeypatch.setattr(trial_part, "TRIAL_TIMES", 3)


def times_of(capture):
    return sorted({view.time for view in capture.views})


def test_it_is_the_stretch_of_time_in_which_pictures_change_most(capture):
    part = trial_part.trial_part(capture)
    # Of stretches of three times, from the first, fourth, eighth and eleventh time on.
    assert times_of(part) == list(TIMES[7:10])
    assert part.time_range == (min(times_of(part)), max(times_of(part)))
    # All cameras are there, held-out ones too.
    names = {view.camera_name for view in capture.views}
    assert {view.camera_name for view in part.views} == names


def test_a_short_capture_is_seen_as_a_whole(capture, monkeypatch):
    monkeypatch.setattr(trial_part, "TRIAL_TIMES", 7)
    assert trial_part.trial_part(capture) is capture


def test_pictures_that_a_camera_lacks_are_replaced_by_the_nearest_ones(capture):
    train = [view for view in capture.views if view.split == "train"]
    lacking = train[0].camera_name
    kept = [
        view
        for view in capture.views
        if view.camera_name != lacking or view.time in TIMES[::4] or view.time == TIMES[8]
    ]
    part = trial_part.trial_part(replace(capture, views=kept))
    assert TIMES[8] in times_of(part)


def test_where_no_camera_stands_still_it_is_the_first_stretch(capture, monkeypatch):
    monkeypatch.setattr(trial_part, "viewpoints", lambda views: list(range(len(views))))
    assert times_of(trial_part.trial_part(capture)) == list(TIMES[:3])


def test_the_trial_sees_the_part_and_the_fit_the_whole(capture, tmp_path, monkeypatch):
    seen, said = {}, []

    class Fitted(Exception):
        pass

    def tried(fits, chosen, candidates, *, say, **_):
        seen["trial"] = len({view.time for view in fits.segment.views})
        seen["shared"] = fits.shared
        return candidates["transient"], {}

    def fitted(session, state, progress):
        seen["fit"] = len(session.times)
        assert session.shared is not seen["shared"]
        raise Fitted

    monkeypatch.setattr(plan, "with_motion_tried", tried)
    monkeypatch.setattr(plan, "tell", lambda text, quiet: said.append(text))
    monkeypatch.setattr(pipeline, "fitted_state", fitted)
    monkeypatch.setattr(choice, "motions", lambda *_: ("transient", "deformation"))
    options = ReconstructOptions(fit=FitOptions(points=20))
    with pytest.raises(Fitted):
        reconstruct(capture, tmp_path, options=options, quiet=True)
    assert (seen["trial"], seen["fit"]) == (3, len(TIMES))
    assert any("successive times" in text for text in said)
