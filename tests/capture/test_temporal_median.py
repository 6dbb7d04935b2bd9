"""Which pixels differ from what a camera that stands still shows most of the time."""

import warnings

import numpy as np
import pytest

from gaussray.capture.temporal_median import differs, temporal_median


def test_moving_pixels_are_far_from_their_temporal_median_in_some_channel():
    frames = np.full((5, 3, 4, 3), 0.5)
    frames[2, 0, 1, 2] = 0.61
    frames[3, 1, 1, 0] = 0.59
    mask = differs(frames, temporal_median(frames))
    assert mask.shape == (5, 3, 4) and mask.dtype == bool
    assert mask.sum() == 1 and mask[2, 0, 1]


def test_the_median_leaves_out_what_is_not_visible():
    frames = np.array([0.0, 0.2, 0.8, 1.0])[:, None, None] * np.ones((2, 3))
    visible = np.array([[1, 0], [1, 0], [0, 0], [0, 0]], bool)
    median = temporal_median(frames, visible)
    np.testing.assert_allclose(median[0], 0.1, rtol=1e-6)
    assert np.isnan(median[1]).all()
    np.testing.assert_allclose(temporal_median(frames), 0.5, rtol=1e-6)


@pytest.mark.parametrize("count", [1, 2, 5, 8, 300])
@pytest.mark.parametrize("masked", [False, True])
def test_the_median_of_bytes_is_that_of_sorting(count, masked):
    dice = np.random.default_rng(count)
    # Few levels, so that many are equal; both ends of the range are among them.
    pictures = dice.choice([0, 1, 100, 101, 254, 255], (count, 3, 2, 3)).astype(np.uint8)
    visible = dice.random((count, 3, 2)) < 0.6 if masked else None
    levels = pictures.astype(float)
    if visible is not None:
        levels[~visible] = np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        expected = np.nanmedian(levels, axis=0)
    np.testing.assert_array_equal(temporal_median(pictures, visible), expected)


def test_pictures_of_several_pieces_have_the_medians_of_their_pixels():
    # Some more than two pieces of 16,384 pixels, the last of which is not full.
    pictures = np.random.default_rng(0).integers(0, 256, (4, 150, 220, 3), np.uint8)
    np.testing.assert_array_equal(temporal_median(pictures), np.median(pictures, axis=0))


def test_bytes_differ_from_a_median_as_their_numbers_do():
    level, median = np.arange(256, dtype=np.uint8), np.append(np.arange(0, 255.5, 0.5), np.nan)
    picture = np.zeros((256, len(median), 3), np.uint8)
    picture[..., 1] = level[:, None]
    other = np.zeros((len(median), 3), np.float16)
    other[:, 1] = median
    expected = np.abs(level[:, None] - median.astype(float)) > 25.5
    np.testing.assert_array_equal(differs(picture, other, 255), expected)
    # Of a median in bytes, too.
    whole = np.flatnonzero(median == np.floor(median))
    levels = other[whole].astype(np.uint8)
    np.testing.assert_array_equal(differs(picture[:, whole], levels, 255), expected[:, whole])


@pytest.mark.parametrize(("level", "expected"), [(25, False), (26, True)])
def test_levels_are_compared_on_their_own_scale(level, expected):
    picture, black = np.full((1, 3), level, np.uint8), np.zeros((1, 3), np.uint8)
    assert differs(picture, black, 255)[0] == expected
    assert differs(picture / np.float32(255), black)[0] == expected
