"""Where pictures change: tiles and points."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.capture.activity import moved_pixels, point_activity, tile_activity
from gaussray.capture.batches import Footage


@pytest.fixture(scope="module")
def footage():
    """A black picture with a white 4 x 4 corner at the last of four instants, from one camera."""
    picture = np.zeros((4, 12, 12, 3), np.uint8)
    picture[3, :4, :4] = 255
    cameras = [toy.camera(time=t, width=12, height=12) for t in (0.0, 1.0, 2.0, 3.0)]
    return Footage(jnp.asarray(picture), jax.tree.map(lambda *x: jnp.stack(x), *cameras), None)


def test_activity_is_the_share_of_pixels_that_leave_the_median(footage):
    moved = moved_pixels(footage, np.array(["a"] * 4))
    np.testing.assert_array_equal(moved, np.asarray(footage.picture)[..., 0] > 0)
    activity = tile_activity(footage, moved, side=8)
    assert activity.shape == (4, 4) and not activity[:3].any()
    # Tiles at 0 and 4: the second ones overlap the first and meet the corner nowhere.
    np.testing.assert_allclose(activity[3], [16 / 64, 0, 0, 0])


def test_a_point_is_as_active_as_its_pixel(footage):
    place = np.array([[-1.2, -1.2, 0], [0.5, 0.5, 0], [0, 0, -99]], np.float32)
    found = point_activity(footage, np.array(["a"] * 4), place)
    np.testing.assert_allclose(found, [0.25, 0, 0])
