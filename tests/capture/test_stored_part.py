"""Means over areas keep light, edges and linear ramps; a window shows its box."""

import tracemalloc

import numpy as np
import pytest

from gaussray.capture.stored_part import Window, averaged


# Sums of a few hundred terms in double precision.
ROUNDING = 1e-12


def by_hand(picture, width, height):
    """Every pixel of the source cut into as many parts as the new picture has pixels: exact."""
    fine = picture.repeat(height, axis=0).repeat(width, axis=1)
    rows, columns, channels = picture.shape
    return fine.reshape(height, rows, width, columns, channels).mean(axis=(1, 3))


@pytest.mark.parametrize(("width", "height"), [(1, 1), (8, 6), (5, 4), (16, 3), (15, 11), (16, 12)])
def test_each_pixel_is_the_mean_over_its_area(width, height):
    picture = np.random.default_rng(0).random((12, 16, 3))
    small = averaged(picture, width, height)
    np.testing.assert_allclose(small, by_hand(picture, width, height), atol=ROUNDING)
    np.testing.assert_allclose(small.mean(axis=(0, 1)), picture.mean(axis=(0, 1)), atol=ROUNDING)


def test_equal_sizes_give_the_picture_back():
    picture = np.random.default_rng(0).random((5, 7, 3)).astype(np.float32)
    same = averaged(picture, 7, 5)
    assert same.dtype == np.float32
    np.testing.assert_array_equal(same, picture)


def test_pixel_centres_stay_where_they_were():
    # A ramp whose value is the place of the pixel's centre: the mean is the place of the new one.
    x = np.broadcast_to(np.arange(20)[None, :, None] + 0.5, (12, 20, 1))
    small = averaged(np.ascontiguousarray(x), 5, 6)
    expected = np.broadcast_to((np.arange(5)[None, :, None] + 0.5) * 4, (6, 5, 1))
    np.testing.assert_allclose(small, expected, atol=ROUNDING)


def test_shares_of_large_pictures_take_little_memory():
    tracemalloc.start()
    averaged(np.ones((20000, 1, 1), np.float32), 1, 10000)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    # A matrix of all pairs would take 1.6 GB.
    assert peak < 2e7


def test_a_window_shows_its_box():
    picture = np.arange(12 * 16).reshape(12, 16)
    np.testing.assert_array_equal(Window((16, 12), (3, 2, 5, 4)).cut(picture), picture[2:6, 3:8])
