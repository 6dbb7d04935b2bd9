"""Points that a reconstruction starts from: outliers go, duplicates merge, all else stays; and
what is put around them."""

import numpy as np
import pytest

from gaussray.capture.points import Points
from gaussray.reconstruct.initialize.from_points import (
    inliers,
    merged,
    on_points,
    surrounding,
    thinned,
    typical_gap,
)
from gaussray.reconstruct.session import scene_extent


LIMIT = 5.0
# Outliers that may stay, because others are near or their part of the cloud is thin.
STAY = 0.05


def sphere(count, dice):
    """Points spread at random on the unit sphere, denser towards one side."""
    place = dice.normal(size=(count, 3)) + [0, 0, 1]
    return (place / np.linalg.norm(place, axis=1, keepdims=True)).astype(np.float32)


def grid():
    """A regular grid, whose border has neighbours on one side alone."""
    return np.stack(np.meshgrid(*[np.arange(12.0)] * 3), axis=-1).reshape(-1, 3).astype(np.float32)


def test_a_typical_gap_is_that_to_the_nearest_point():
    assert typical_gap(3 * grid()) == 3
    assert typical_gap(np.zeros((9, 3))) > 0


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_clean_clouds_of_any_scale_are_kept_whole(scale):
    assert inliers(scale * sphere(2000, np.random.default_rng(0)), LIMIT).all()
    assert inliers(scale * grid(), LIMIT).all()


def test_nearly_all_points_far_from_a_surface_go_and_no_other():
    dice = np.random.default_rng(0)
    clean = sphere(2000, dice)
    # Several times further from the sphere than its points from each other.
    far = dice.uniform(-3, 3, (100, 3)).astype(np.float32)
    far = far[np.abs(np.linalg.norm(far, axis=1) - 1) > 0.7]
    keep = inliers(np.concatenate([clean, far]), LIMIT)
    assert len(far) > 60 and keep[: len(clean)].all()
    assert keep[len(clean) :].mean() < STAY


def test_a_few_points_are_kept_wherever_they_are():
    assert inliers(np.eye(3, dtype=np.float32)[[0, 1, 2] * 10] * 1e6, LIMIT).all()


def test_points_of_one_place_become_one_of_their_mean_colour():
    position = np.float32([[1, 0, 0], [0, 0, 0], [1, 0, 0], [2, 0, 0], [1, 0, 0]])
    color = np.float32([[0.3, 0, 0], [1, 1, 1], [0.6, 0, 0.3], [0, 1, 0], [0, 0.6, 0]])
    place, mean = merged(position, color)
    np.testing.assert_array_equal(place, position[[0, 1, 3]])
    np.testing.assert_allclose(mean, [[0.3, 0.2, 0.1], [1, 1, 1], [0, 1, 0]], rtol=1e-6)
    # Without any, nothing is touched, nor put in another order.
    np.testing.assert_array_equal(merged(place[::-1], mean)[0], place[::-1])


def test_around_a_box_are_six_alike_that_every_ray_out_of_it_passes():
    dice = np.random.default_rng(0)
    lower, size = np.array([1.0, -2.0, 3.0]), np.array([4.0, 2.0, 1.0])
    cloud = (lower + size * dice.random((20_000, 3))).astype(np.float32)
    place, color = surrounding(cloud, count=6000, seed=0)
    assert place.shape == color.shape == (6000, 3)
    np.testing.assert_array_equal(place, surrounding(cloud, count=6000, seed=0)[0])
    unit = (place - lower) / size
    # Half a per cent of the points is left out at either side as strays.
    beyond = ((unit < 0) | (unit > 1)).sum(axis=1)
    assert beyond.max() == 1 and beyond.mean() > 0.98 and np.abs(unit - 0.5).max() < 1.52
    faces = [(unit[:, axis] < 0).sum() for axis in range(3)]
    faces += [(unit[:, axis] > 1).sum() for axis in range(3)]
    # A sixth each, within four standard deviations of the count; few fall between box and face.
    assert np.abs(np.array(faces) - 1000).max() < 4 * np.sqrt(1000 * 5 / 6) + 30


def test_strays_do_not_stretch_the_box_that_is_surrounded():
    cloud = np.random.default_rng(0).random((1000, 3)).astype(np.float32)
    cloud[:3] = 1e6
    assert np.abs(surrounding(cloud, count=100, seed=1)[0]).max() < 2.1


@pytest.mark.parametrize("unit", [2.0**-40, 2.0**40])
def test_a_start_knows_no_unit_of_length(unit):
    place, grey = sphere(100, np.random.default_rng(0)), np.full((100, 3), 0.5, np.float32)
    larger = np.float32(unit) * place
    discs = [on_points(x, grey, degree=0, opacity=0.5).scale for x in (place, larger)]
    np.testing.assert_allclose(discs[1], unit * discs[0], rtol=1e-5)
    around = [surrounding(x, count=50, seed=0)[0] for x in (place, larger)]
    np.testing.assert_allclose(around[1], unit * around[0], rtol=1e-5)


@pytest.mark.parametrize("unit", [2.0**-40, 1.0, 2.0**40])
def test_the_unit_of_a_fit_is_in_proportion_to_the_capture(unit):
    eye = np.float32(unit) * np.float32([[0, 0, 0], [3, 0, 4]])
    points = Points(np.float32(unit) * np.float32([[0, 0, 1000]]), np.zeros((1, 3), np.float32))
    assert scene_extent(eye, points) == pytest.approx(2.5 * unit)
    # A camera that stands alone is as good as a thousandth of its distance.
    assert scene_extent(eye[:1], points) == pytest.approx(unit)


def test_a_budget_keeps_so_many_points_in_their_order():
    chosen = thinned(20, count=7, seed=1)
    assert chosen.shape == (7,) and (np.diff(chosen) > 0).all() and chosen.max() < 20
    np.testing.assert_array_equal(thinned(20, count=20, seed=1), np.arange(20))
