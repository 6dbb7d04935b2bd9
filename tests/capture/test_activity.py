"""Where pictures change, and how training tiles are drawn there."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.capture.activity import point_activity, tile_activity
from gaussray.capture.batches import Footage, Sampler, tile_rays


@pytest.fixture(scope="module")
def footage():
    """A black picture with a white 4 x 4 corner at the last of four instants, from one camera."""
    picture = np.zeros((4, 12, 12, 3), np.uint8)
    picture[3, :4, :4] = 255
    cameras = [toy.camera(time=t, width=12, height=12) for t in (0.0, 1.0, 2.0, 3.0)]
    return Footage(jnp.asarray(picture), jax.tree.map(lambda *x: jnp.stack(x), *cameras), None)


def test_activity_is_the_share_of_pixels_that_leave_the_median(footage):
    activity = tile_activity(footage, np.array(["a"] * 4), side=8)
    assert activity.shape == (4, 4) and not activity[:3].any()
    # Tiles at 0 and 4: the second ones overlap the first and meet the corner nowhere.
    np.testing.assert_allclose(activity[3], [16 / 64, 0, 0, 0])


def test_a_point_is_as_active_as_its_pixel(footage):
    place = np.array([[-1.2, -1.2, 0], [0.5, 0.5, 0], [0, 0, -99]], np.float32)
    found = point_activity(footage, np.array(["a"] * 4), place)
    np.testing.assert_allclose(found, [0.25, 0, 0])


def test_tiles_that_do_not_divide_overlap_and_hold_their_pixels(footage):
    frame, tile = jnp.array([3, 3], jnp.int32), jnp.array([0, 3], jnp.int32)
    rays, color, weight = tile_rays(footage, frame, tile, side=8)
    assert color.shape == (128, 3) and rays.time.shape == (128,)
    np.testing.assert_array_equal(color[:64, 0].reshape(8, 8)[:4, :4], 1)
    assert color[:64].sum() == 16 * 3 and color[64:].sum() == 0 and (weight == 1).all()
    np.testing.assert_allclose(rays.time, 3)


def test_draws_follow_the_balance_and_the_seed():
    times, activity = np.array([0.0, 0.0, 1.0]), np.zeros((3, 10), np.float32)
    activity[1, 4] = 1
    instants = np.zeros(6, int)
    sampler = Sampler(times, activity, tiles=30, balance=0.5)
    frame, tile = sampler.draw(instants, np.random.default_rng(0))
    assert set(np.unique(frame)) <= {0, 1}
    # Half of the draws, and a 20th of the other half.
    assert 0.35 < np.mean((frame == 1) & (tile == 4)) < 0.7
    again, _ = sampler.draw(instants, np.random.default_rng(0))
    np.testing.assert_array_equal(frame, again)
    frame, _ = sampler.draw(np.ones(6, int), np.random.default_rng(0))
    assert (frame == 2).all()
