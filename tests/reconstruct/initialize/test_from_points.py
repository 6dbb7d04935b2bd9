"""Points that a reconstruction starts from: outliers go, duplicates merge, all else stays; and
what is put around them."""

import jax.numpy as jnp
import numpy as np
import pytest

from gaussray.capture.points import Points
from gaussray.reconstruct.initialize.from_points import (
    ball_around,
    bodies,
    inliers,
    merged,
    on_points,
    surrounding,
    thinned,
    typical_gap,
)
from gaussray.reconstruct.session import scene_extent
from gaussray.scene.bodies import body_of


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


def test_bodies_that_are_known_stay_two_where_they_touch_and_new_ones_are_found():
    centers = np.float32([[0, 0, 0], [1.05, 0, 0], [5, 0, 0], [9, 0, 0]])
    # Fibonacci's lattice: as even as a scanned surface.
    turn, height = np.pi * (1 + 5**0.5) * np.arange(300), 1 - (2 * np.arange(300) + 1) / 300
    ring = np.sqrt(1 - height**2)
    ball = np.stack([ring * np.cos(turn), ring * np.sin(turn), height], axis=-1)
    balls = [(center + 0.5 * ball).astype(np.float32) for center in centers]
    cloud, times = np.concatenate(balls[:3]), np.float32([0, 1])
    assert len(bodies(cloud, times).pivot) == 2
    # The last of the known ones is not among the points that move now.
    known = centers[[0, 1, 3]], np.float32([0.55, 0.55, 0.55])
    found = bodies(cloud, times, known=known)
    np.testing.assert_array_equal(found.pivot[:2], centers[:2])
    assert len(found.pivot) == 3 and np.linalg.norm(found.pivot[2] - centers[2]) < 0.5
    member = np.asarray(body_of(found, jnp.asarray(cloud)))
    np.testing.assert_array_equal(member, np.repeat([0, 1, 2], 300))
    assert not np.any(found.path) and len(bodies(cloud[:0], times, known=known).pivot) == 0


def test_a_budget_keeps_so_many_points_in_their_order():
    chosen = thinned(20, count=7, seed=1)
    assert chosen.shape == (7,) and (np.diff(chosen) > 0).all() and chosen.max() < 20
    np.testing.assert_array_equal(thinned(20, count=20, seed=1), np.arange(20))


@pytest.mark.parametrize("cap", [1.0, 0.0])
def test_the_smallest_ball_around_half_a_ball_is_that_of_the_ball(cap):
    dice = np.random.default_rng(0)
    place = dice.normal(size=(20_000, 3))
    place /= np.linalg.norm(place, axis=1, keepdims=True)
    place = place[place[:, 2] > -cap]
    center, radius = ball_around(np.array([3.0, -1, 2]) + 0.5 * place, gap=0.01)
    # A hundredth of the radius; the centre of a half is told less well along its axis.
    np.testing.assert_allclose(center, [3, -1, 2], atol=0.02)
    assert radius == pytest.approx(1.05 * 0.5 + 0.01, rel=0.015)
