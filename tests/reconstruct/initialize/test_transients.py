"""The first transient Gaussians stand on the points of their time and move as these do."""

import numpy as np
import pytest
import toy

from gaussray.reconstruct.initialize import transients
from gaussray.reconstruct.initialize.stereo.from_pictures import MovingPoints
from gaussray.reconstruct.initialize.stereo.points import StereoPoints, no_points
from gaussray.reconstruct.initialize.transients import initial_transients, starting_times
from gaussray.scene.transient import transients_at


TIMES = np.array([0.0, 0.25, 0.5, 0.75])
COUNT = 200
# Single precision.
CLOSE = 1e-6


def cloud(time, count=COUNT):
    """Points of a square of side 1 in the plane z = 3, which goes to +x with speed 2; the velocity
    of the last tenth is not known."""
    dice = np.random.default_rng(round(100 * time))
    place = np.concatenate([dice.random((count, 2)), np.full((count, 1), 3.0)], axis=1)
    place[:, 0] += 2 * time
    color = np.full((count, 3), 0.5, np.float32)
    one = np.ones(count, np.float32)
    points = StereoPoints(place.astype(np.float32), 0 * color, color, one, one, one)
    velocity = np.tile(np.float32([2, 0, 0]), (count, 1))
    residual = np.where(np.arange(count) < 0.9 * count, 0.5, 3.0).astype(np.float32)
    return MovingPoints(points, time, velocity, residual)


@pytest.fixture
def seen():
    """The square at every time but the last, and there too little of it."""
    return [*map(cloud, TIMES[:3]), cloud(TIMES[3], count=3)]


def first(clouds, **changes):
    options = {"count": 10**6, "degree": 1, "seed": 0} | changes
    return initial_transients(clouds, TIMES, **options)


def test_every_time_has_its_gaussians_which_live_until_the_next(seen):
    found = first(seen)
    times, counts = np.unique(np.asarray(found.instant), return_counts=True)
    # Three strays tell nothing of their size.
    np.testing.assert_allclose(times, TIMES[:3])
    assert counts.tolist() == [COUNT] * 3
    np.testing.assert_allclose(found.lifetime, 0.25)
    assert found.harmonics.shape == (3 * COUNT, 4, 3) and not np.any(found.plateau)


def test_they_go_where_the_square_goes(seen):
    found = first(seen)
    own = np.asarray(found.instant) == 0.25
    known = np.asarray(found.velocity)[own, 0] == 2
    assert known.sum() == 0.9 * COUNT
    later = np.asarray(transients_at(found, toy.single(0.5)).mean)[own][known]
    assert later[:, 0].min() > 0.99 and later[:, 0].max() < 2.01
    # Discs in the plane of the square, as flat as they may start.
    np.testing.assert_allclose(found.scale[:, 2], transients._FLAT * found.scale[:, 0], rtol=CLOSE)


def test_a_budget_is_shared_by_all_times(seen):
    found = first(seen, count=90)
    counts = np.unique(np.asarray(found.instant), return_counts=True)[1]
    assert counts.tolist() == [30, 30, 30]


def test_where_stereo_finds_nothing_there_are_none():
    nothing = MovingPoints(no_points(), 0.0, np.zeros((0, 3)), np.zeros(0))
    assert first([nothing] * 4).count == 0


def test_few_times_are_all_taken_and_many_evenly():
    np.testing.assert_array_equal(starting_times(TIMES, 4), TIMES)
    many = np.linspace(0, 1, 101)
    np.testing.assert_allclose(starting_times(many, 5), [0, 0.25, 0.5, 0.75, 1])
