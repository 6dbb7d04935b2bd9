"""What experiments/videos says of poses is right."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from experiments.videos.poses import compared


SCALE, OFF = 0.37, 0.2  # metres a unit; degrees


@pytest.fixture
def places():
    """Camera to world of seven cameras, and the same in another world."""
    rng = np.random.default_rng(4)
    turns = Rotation.random(7, random_state=rng)
    true = np.concatenate([turns.as_matrix(), rng.normal(size=(7, 3, 1))], axis=2)
    world = Rotation.random(random_state=rng).as_matrix()
    centre = (true[:, :, 3:] - rng.normal(size=(3, 1))) / SCALE
    return true, np.concatenate([world @ true[:, :, :3], world @ centre], axis=2)


def test_another_world_is_no_error(places):
    true, found = places
    error, turned, scale = compared(found, true)
    assert scale == pytest.approx(SCALE, abs=1e-12)
    assert error.max() < 1e-12 and turned.max() < 1e-5  # an angle is the root of what is lost


def test_a_camera_that_is_turned_is_alone_with_it(places):
    true, found = places
    off = Rotation.from_rotvec([0, np.radians(OFF), 0]).as_matrix()
    found[3, :, :3] = found[3, :, :3] @ off
    error, turned, _ = compared(found, true)
    assert error.max() < 1e-12 and turned[3] == pytest.approx(OFF, rel=1e-6)
    assert np.delete(turned, 3).max() < 1e-5


def test_a_camera_that_is_shifted_has_the_largest_error(places):
    true, found = places
    found[2, 0, 3] += 0.01
    error, _, _ = compared(found, true)
    assert error.argmax() == 2 and 0 < error[2] < 0.01 * SCALE


def test_a_mirrored_world_is_no_similarity(places):
    true, found = places
    found[:, 0, 3] *= -1
    assert compared(found, true)[0].max() > 0.1
