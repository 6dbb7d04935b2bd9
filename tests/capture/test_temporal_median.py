"""Which pixels differ from what a camera that stands still shows most of the time."""

import numpy as np
import pytest

from gaussray.capture.temporal_median import differs, moving_mask, temporal_median


def test_moving_pixels_are_far_from_their_temporal_median_in_some_channel():
    frames = np.full((5, 3, 4, 3), 0.5)
    frames[2, 0, 1, 2] = 0.61
    frames[3, 1, 1, 0] = 0.59
    mask = moving_mask(frames)
    assert mask.shape == (5, 3, 4) and mask.dtype == bool
    assert mask.sum() == 1 and mask[2, 0, 1]


def test_the_median_leaves_out_what_is_not_visible():
    frames = np.array([0.0, 0.2, 0.8, 1.0])[:, None, None] * np.ones((2, 3))
    visible = np.array([[1, 0], [1, 0], [0, 0], [0, 0]], bool)
    median = temporal_median(frames, visible)
    np.testing.assert_allclose(median[0], 0.1, rtol=1e-6)
    assert np.isnan(median[1]).all()
    np.testing.assert_allclose(temporal_median(frames), 0.5, rtol=1e-6)


@pytest.mark.parametrize(("level", "expected"), [(25, False), (26, True)])
def test_levels_are_compared_on_their_own_scale(level, expected):
    picture, black = np.full((1, 3), level, np.uint8), np.zeros((1, 3), np.uint8)
    assert differs(picture, black, 255)[0] == expected
    assert differs(picture / np.float32(255), black)[0] == expected
