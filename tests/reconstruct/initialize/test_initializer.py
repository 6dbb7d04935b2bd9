"""Which points a reconstruction starts from, by fit.start and by what there is."""

import inspect
from types import SimpleNamespace

import numpy as np
import pytest

from gaussray.capture.errors import CaptureWarning
from gaussray.capture.points import Points
from gaussray.reconstruct.initialize import initializer
from gaussray.reconstruct.options import FitOptions
from gaussray.runtime.progress import no_report


GIVEN, MATCHED, RANDOM, GUESSED = 40, 300, 64, 48


def cloud(count, seed):
    position = np.random.default_rng(seed).random((count, 3)).astype(np.float32)
    return Points(position, np.full((count, 3), 0.5, np.float32))


@pytest.fixture
def started(monkeypatch):
    """The points of a start, where stereo finds so many."""

    def start(word, *, given=None, matched=MATCHED, points=RANDOM, guessed=GUESSED, covered=1.0):
        random = initializer.InitialPoints(np.zeros((points, 3)), np.zeros((points, 3)), False)
        monkeypatch.setattr(initializer, "points_in_view", lambda *_: random)
        monkeypatch.setattr(initializer, "points_of_stereo", lambda *_: cloud(matched, 1))
        monkeypatch.setattr(initializer, "covers", inspect.unwrap(initializer.covers))
        monkeypatch.setattr(initializer, "first_views", lambda *_: None)
        monkeypatch.setattr(initializer, "coverage", lambda *_, **__: covered)
        monkeypatch.setattr(initializer, "still_views", lambda *_: None)
        monkeypatch.setattr(initializer, "backdrop_of", lambda *_: None)
        monkeypatch.setattr(initializer, "uncovered_points", lambda *_, **__: cloud(0, 2))
        monkeypatch.setattr(initializer, "guessed_points", lambda *_, **__: cloud(guessed, 3))
        plain = inspect.unwrap(initializer.points_at_guessed_distances)
        monkeypatch.setattr(initializer, "points_at_guessed_distances", plain)
        capture = SimpleNamespace(points=given)
        options = FitOptions(start=word, points=points, outliers=0.0)
        return inspect.unwrap(initializer.initial_points)(
            capture, None, options, lambda name: no_report
        )

    return start


@pytest.mark.parametrize(
    ("word", "given", "count", "on_surfaces"),
    [
        ("auto", None, MATCHED, True),
        ("auto", 100, 100, True),
        ("given", 100, 100, True),
        ("given", None, RANDOM, False),
        ("stereo", 100, MATCHED, True),
        ("stereo", None, MATCHED, True),
        ("random", 100, RANDOM, False),
    ],
)
def test_points_come_from_where_the_start_says(started, word, given, count, on_surfaces):
    points = started(word, given=None if given is None else cloud(given, 0))
    assert len(points.position) == count and points.on_surfaces == on_surfaces


@pytest.mark.parametrize("count", [GIVEN, 2 * RANDOM])
def test_given_points_that_leave_much_empty_stay_and_stereo_adds_to_them(started, count):
    given = cloud(count, 0)
    points = started("auto", given=given, covered=0.5)
    np.testing.assert_array_equal(points.position[:count], given.position)
    assert count < len(points.position) <= count + MATCHED


def test_given_points_that_lie_everywhere_are_enough_whatever_their_number(started):
    points = started("auto", given=cloud(GIVEN, 0), covered=0.9)
    # The missing ones are put between them.
    assert len(points.position) == RANDOM


def test_where_stereo_finds_too_few_points_they_are_guessed_with_a_warning(started):
    with pytest.warns(CaptureWarning, match="stereo finds 12 points"):
        points = started("auto", matched=12)
    assert len(points.position) == GUESSED and not points.on_surfaces


def test_where_nothing_can_be_guessed_the_start_is_random(started):
    with pytest.warns(CaptureWarning, match="stereo finds 0 points"):
        points = started("auto", matched=0, guessed=0)
    assert len(points.position) == RANDOM and not points.on_surfaces


def test_an_unknown_start_is_refused_with_those_there_are():
    with pytest.raises(ValueError, match="fit.start must be one of auto, given, stereo, random"):
        FitOptions(start="colmap")


def test_stereo_fills_up_known_points_only_where_they_leave_surfaces_empty():
    x, y = np.meshgrid(np.arange(20.0), np.arange(10.0))
    plane = np.stack([x.ravel(), y.ravel(), np.zeros(200)], axis=1).astype(np.float32)
    known = Points(plane[plane[:, 0] < 10], np.zeros((100, 3), np.float32))
    matched = Points(plane + np.float32([0.2, 0.1, 0]), np.ones((200, 3), np.float32))
    whole = initializer.filled_up(known, matched)
    np.testing.assert_array_equal(whole.position[:100], known.position)
    added = whole.position[100:]
    assert len(added) == 100 and added[:, 0].min() > 10 and np.all(whole.color[100:] == 1)
