"""Velocities by patch registration: a patch that is moved and turned is found again."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from gaussray.geometry import rotation_matrix, turning
from gaussray.reconstruct.initialize.stereo.velocity import (
    RegistrationOptions,
    registered,
    rigid,
)


SMALL = RegistrationOptions(seeds=24, patch=24, hypotheses=24, points=512, around=3, own=8)
# Displacements of points that are sampled anew, in gaps between points.
RIGHT = 1.0
# The same numbers, rounded in another order (float64).
SAME = 1e-9


def blob(dice, count=400):
    """A bumpy closed surface with smooth colours, at the points that `dice` draw on it."""
    normal = dice.normal(size=(count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    radius = 1 + 0.3 * np.sin(3 * normal[:, :1]) + 0.2 * np.cos(4 * normal[:, 1:2])
    color = 0.5 + 0.5 * np.sin(4 * normal + [0, 1, 2])
    return radius * normal, color


def test_a_rigid_motion_is_recovered_exactly_from_matches():
    dice = np.random.default_rng(0)
    source = jnp.asarray(dice.normal(size=(20, 3)))
    quat = turning(jnp.asarray([0.3, -1.1, 0.7]))
    shift = jnp.asarray([0.2, 0.5, -3.0])
    target = source @ rotation_matrix(quat).T + shift[None]
    found, way = rigid(source, target, jnp.asarray(dice.random(20) + 0.1))
    assert np.allclose(rotation_matrix(found), rotation_matrix(quat), atol=1e-9)
    assert np.allclose(way, shift, atol=1e-9)


def test_points_of_a_moved_and_turned_surface_get_their_displacements():
    place, color = blob(np.random.default_rng(1))
    turn = np.asarray(rotation_matrix(turning(jnp.asarray([0.0, 0.0, 0.4]))))
    shift = np.array([0.8, -0.5, 0.3])
    other, shade = blob(np.random.default_rng(2))
    motion = registered(place, color, other @ turn.T + shift, shade, reach=2.0, options=SMALL)
    error = np.linalg.norm(motion.displacement - (place @ turn.T + shift - place), axis=1)
    gap = 0.09  # of 400 points on this surface
    assert np.median(error) < RIGHT * gap
    assert np.quantile(error, 0.9) < 3 * RIGHT * gap
    nearest = np.linalg.norm(other @ turn.T + shift - place[:, None], axis=-1).min(axis=1)
    assert np.median(error) < 0.3 * np.median(nearest)


def test_patches_at_once_move_as_one_after_the_other():
    place, color = blob(np.random.default_rng(1))
    other, shade = blob(np.random.default_rng(2))
    motions = [
        registered(place, color, other + 0.3, shade, reach=2.0, options=options)
        for options in (SMALL, replace(SMALL, at_once=10))
    ]
    assert np.allclose(motions[0].displacement, motions[1].displacement, atol=SAME)


def test_points_that_stand_still_do_not_move():
    place, color = blob(np.random.default_rng(1))
    motion = registered(place, color, place, color, reach=1.0, options=SMALL)
    assert np.abs(motion.displacement).max() < 1e-6
    assert motion.residual.max() < 1e-3


def test_too_few_points_are_lost():
    place, color = np.zeros((3, 3)), np.zeros((3, 3))
    motion = registered(place, color, place, color, reach=1.0, options=SMALL)
    assert not motion.displacement.any() and (motion.residual > 1).all()
