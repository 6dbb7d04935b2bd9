"""Control points follow a painted sheet that bends, of which every time has other points."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gaussray.reconstruct.initialize.nonrigid_registration import RegistrationOptions
from gaussray.reconstruct.initialize.stereo.from_pictures import MovingPoints
from gaussray.reconstruct.initialize.stereo.points import StereoPoints
from gaussray.reconstruct.initialize.surface_tracking import tracked_surface
from gaussray.scene.control_points import control_motion


TIMES = (0.0, 0.25, 0.5, 0.75, 1.0)
OPTIONS = RegistrationOptions(control=60, source=900, target=900)
# A sheet of 1 x 1 that moves by 0.8 and turns by 1 radian is followed to the distance between its
# 900 points.
NEAR = 1 / 30


def sheet(u, time):
    """Places of the parameters (n, 2) in 0..1: a sheet that bends, turns and moves."""
    x, y = u.T - 0.5
    z = 0.25 * np.sin(3 * x + 2 * time) - 0.25 * np.sin(2 * time)
    c, s = np.cos(time), np.sin(time)
    return np.stack([c * x - s * y + 0.8 * time, s * x + c * y, z], axis=1)


def paint(u):
    """Colours that tell the places apart, as far as colours can."""
    return np.stack([0.5 + 0.5 * np.sin(7 * u[:, 0]), u[:, 1], 0.5 + 0.5 * np.cos(9 * u[:, 1])], 1)


def cloud(time, seed, count=900, noise=0.003):
    dice = np.random.default_rng(seed)
    u = dice.random((count, 2))
    position = sheet(u, time) + noise * dice.normal(size=(count, 3))
    one = np.ones(count, np.float32)
    found = StereoPoints(
        position.astype(np.float32), np.zeros((count, 3), np.float32),
        paint(u).astype(np.float32), one, one, one,
    )  # fmt: skip
    return MovingPoints(found, time, np.zeros_like(found.position), 3 * one)


def parameters_of(position):
    """The parameters of the nearest places on the sheet at the first time."""
    grid = np.stack(np.meshgrid(*[np.linspace(0, 1, 401)] * 2), -1).reshape(-1, 2)
    there = sheet(grid, 0.0)
    return np.array([grid[np.argmin(np.sum((there - p) ** 2, axis=1))] for p in position])


@pytest.fixture(scope="module")
def clouds():
    return [cloud(time, k) for k, time in enumerate(TIMES)]


@pytest.fixture(scope="module")
def control(clouds):
    calls = []
    found = tracked_surface(clouds, options=OPTIONS, report=lambda *x: calls.append(x))
    assert calls == [(k, 4) for k in range(1, 5)]
    return found


def test_control_points_follow_a_sheet_that_bends_turns_and_moves(control):
    u = parameters_of(np.asarray(control.pivot))
    for k, time in enumerate(TIMES):
        away = np.asarray(control.pivot + control.path[:, k]) - sheet(u, time)
        assert np.quantile(np.linalg.norm(away, axis=1), 0.9) < NEAR
    moved = np.linalg.norm(np.asarray(control.path[:, -1]), axis=1)
    assert moved.min() > 0.3


def test_places_between_control_points_follow_as_well(control):
    u = 0.1 + 0.8 * np.random.default_rng(9).random((200, 2))
    start = jnp.asarray(sheet(u, 0.0), jnp.float32)
    shift, turn = control_motion(control, start, jnp.asarray(1.0, jnp.float32))
    away = np.asarray(start + shift) - sheet(u, 1.0)
    assert np.quantile(np.linalg.norm(away, axis=1), 0.9) < NEAR
    # The sheet turns by 1 radian about +z, and bends by less.
    assert (
        abs(np.median(np.abs(2 * np.arctan2(np.asarray(turn)[:, 3], np.asarray(turn)[:, 0]))) - 1)
        < 0.1
    )


def test_a_time_without_points_changes_nothing(clouds):
    gone = cloud(0.5, 2, count=3)
    found = tracked_surface([*clouds[:2], gone], options=OPTIONS)
    np.testing.assert_array_equal(found.path[:, 2], found.path[:, 1])
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(found))


def test_a_part_without_anything_to_match_stays_finite(clouds):
    """Half of the sheet is out of sight at the later time."""
    there = clouds[1].points
    half = there.position[:, 0] < 0.1
    seen = clouds[1]._replace(points=StereoPoints(*(x[half] for x in there)))
    found = tracked_surface([clouds[0], seen], options=OPTIONS)
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(found))
    assert np.linalg.norm(found.path[:, 1], axis=1).max() < 1


def test_points_at_one_place_keep_a_width(clouds):
    first = clouds[0].points
    same = first._replace(position=np.repeat(first.position[::9], 9, axis=0)[: len(first.scale)])
    found = tracked_surface([clouds[0]._replace(points=same), *clouds[1:2]], options=OPTIONS)
    assert found is None or all(np.isfinite(x).all() for x in jax.tree.leaves(found))
    assert found is None or float(found.radius.min()) > 0


def test_too_little_to_follow_is_none(clouds):
    assert tracked_surface([cloud(0.0, 0, count=20), *clouds[1:]], options=OPTIONS) is None
    assert tracked_surface(clouds[:1], options=OPTIONS) is None


def test_velocities_lead_to_what_moves_farther_than_matches_reach(clouds):
    """The sheet rests and then jumps by three times its width; its velocities know."""
    jump = np.array([3.0, 0, 0], np.float32)
    first, second, last = (cloud(0.0, seed) for seed in (1, 2, 3))
    last = last._replace(points=last.points._replace(position=last.points.position + jump))
    second, last = second._replace(time=0.25), last._replace(time=0.5)
    told = second._replace(
        velocity=np.tile(4 * jump, (len(second.velocity), 1)), residual=0 * second.residual
    )

    def error(between):
        found = tracked_surface([first, between, last], options=OPTIONS)
        return np.median(np.linalg.norm(np.asarray(found.path[:, 2]) - jump, axis=1))

    assert error(told) < NEAR
    # Velocities that are not believed do not count.
    assert error(told._replace(residual=second.residual)) > 10 * NEAR
