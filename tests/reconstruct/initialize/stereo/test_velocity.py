"""Displacements by non-rigid registration: what moved, turned or bent is found again."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from gaussray.geometry import rotation_matrix, turning
from gaussray.reconstruct.initialize import nonrigid_registration
from gaussray.reconstruct.initialize.stereo.points import StereoPoints, no_points
from gaussray.reconstruct.initialize.stereo.velocity import point_motion, velocity_options


SMALL = replace(velocity_options("gpu"), control=100, source=800, target=800)
# The gap between 800 points of the surface, of radius 1.
GAP = 0.065


def cloud(position, color):
    one = np.ones(len(position))
    return StereoPoints(position, np.zeros_like(position), color, one, one, one)


def blob(seed, count=800):
    """A bumpy closed surface with smooth colours, at points that are drawn on it."""
    normal = np.random.default_rng(seed).normal(size=(count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    radius = 1 + 0.3 * np.sin(3 * normal[:, :1]) + 0.2 * np.cos(4 * normal[:, 1:2])
    return radius * normal, 0.5 + 0.5 * np.sin(4 * normal + [0, 1, 2])


def moved(place):
    """Turned by 0.3 radians, and by half a radius aside."""
    turn = np.asarray(rotation_matrix(turning(jnp.asarray([0.0, 0.0, 0.3]))))
    return place @ turn.T + [0.4, -0.25, 0.15]


def bent(place):
    """Sheared by more, the further up."""
    return place + 0.2 * np.stack([place[:, 2] ** 2, np.sin(2 * place[:, 0]), 0 * place[:, 0]], 1)


@pytest.mark.parametrize("way", [moved, bent])
def test_points_of_another_time_tell_the_displacements(way):
    place, color = blob(1)
    other, shade = blob(2)
    motion = point_motion(cloud(place, color), cloud(way(other), shade), options=SMALL)
    error = np.linalg.norm(motion.displacement - (way(place) - place), axis=1)
    assert np.median(error) < 0.5 * GAP
    assert np.quantile(error, 0.9) < 1.5 * GAP
    assert (motion.residual < 1).all()


def test_points_that_stand_still_do_not_move():
    here = cloud(*blob(1))
    motion = point_motion(here, here, options=SMALL)
    # A few points that have none around them are matched with, and do not match themselves.
    assert np.median(np.abs(motion.displacement)) < 0.02 * GAP
    assert np.abs(motion.displacement).max() < GAP
    assert motion.residual.max() < 0.2


def test_points_that_are_not_matched_are_carried_by_those_around():
    place, color = blob(1, 3000)
    other, shade = blob(2)
    few = replace(SMALL, source=400)
    motion = point_motion(cloud(place, color), cloud(moved(other), shade), options=few)
    error = np.linalg.norm(motion.displacement - (moved(place) - place), axis=1)
    assert np.quantile(error, 0.9) < 1.5 * GAP


def test_what_has_nothing_to_match_is_lost():
    """A second surface far away is gone at the other time."""
    place, color = blob(1)
    here = cloud(np.concatenate([place, place + 30]), np.tile(color, (2, 1)))
    motion = point_motion(here, cloud(moved(blob(2)[0]), blob(2)[1]), options=SMALL)
    assert np.isfinite(motion.displacement).all()
    assert (motion.residual[:800] < 2).mean() > 0.95
    assert (motion.residual[800:] == 3).all()


@pytest.mark.parametrize("counts", [(0, 0), (0, 800), (800, 0), (3, 800), (800, 60), (60, 60)])
def test_too_few_points_are_lost(counts):
    here, there = (cloud(*blob(1, count)) if count else no_points() for count in counts)
    motion = point_motion(here, there, options=SMALL)
    assert motion.displacement.shape == here.position.shape and not motion.displacement.any()
    assert motion.residual.shape == here.scale.shape and (motion.residual == 3).all()


def test_a_cpu_matches_fewer_points():
    assert velocity_options("cpu").source < velocity_options("gpu").source


def test_points_of_one_place_move_as_one():
    one = np.ones((200, 3))
    here, (place, color) = cloud(one, np.full((200, 3), 0.5)), blob(1)
    motion = point_motion(here, here, options=SMALL)
    assert not motion.displacement.any() and not motion.residual.any()
    motion = point_motion(here, cloud(place, color), options=SMALL)
    assert np.ptp(motion.displacement, axis=0).max() == 0 and np.ptp(motion.residual) == 0
    away = np.linalg.norm(one[:1] - place, axis=1).min()
    assert np.linalg.norm(one[:1] + motion.displacement[:1] - place, axis=1).min() < away
    motion = point_motion(cloud(place, color), here, options=SMALL)
    away = np.linalg.norm(place - one[:1], axis=1).mean()
    assert np.linalg.norm(place + motion.displacement - one[:1], axis=1).mean() < away
    assert ((motion.residual >= 0) & (motion.residual <= 3)).all()


def test_a_registration_without_an_answer_is_lost(monkeypatch):
    def nothing(surface, control, *rest, solves):
        return control[0] * np.nan, np.ones((len(control[0]), 4))

    monkeypatch.setattr(nonrigid_registration, "_registered", nothing)
    motion = point_motion(cloud(*blob(1)), cloud(*blob(2)), options=SMALL)
    assert not motion.displacement.any() and (motion.residual == 3).all()
