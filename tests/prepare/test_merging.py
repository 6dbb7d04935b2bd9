"""Which cameras stand still, by where the features of two timestamps lie."""

import numpy as np
import pytest

from gaussray.prepare.features import Keypoints
from gaussray.prepare.merging import staying_share


# Columns and rows: cells of 8 x 8 are 100 x 80 pixels.
SIZE = (800, 640)


def keypoints(xy):
    return Keypoints(np.asarray(xy, float), np.zeros(len(xy), int))


def middles(columns, rows):
    """The middles of cells."""
    x, y = np.meshgrid(100 * np.asarray(columns) + 50, 80 * np.asarray(rows) + 40)
    return np.stack([x.ravel(), y.ravel()], axis=-1).astype(float)


def share(before, after):
    rows = np.arange(len(before))[:, None].repeat(2, axis=1)
    return staying_share(keypoints(before), keypoints(after), rows, SIZE)


def test_a_body_with_most_of_the_features_moves_before_a_camera_that_stands_still():
    background = middles(range(8), range(6))
    body = np.random.default_rng(0).uniform((0, 480), (800, 640), (2000, 2))
    before = np.concatenate([background, body])
    after = np.concatenate([background, body + (30, 0)])
    # 48 of 64 cells stay, and 48 of 2048 features.
    assert share(before, after) == pytest.approx(0.75)


def test_many_features_that_stay_in_a_few_cells_count_one_by_one():
    crowd = np.random.default_rng(0).uniform((0, 0), (100, 80), (900, 2))
    others = middles(range(1, 6), range(1, 6))
    before, after = np.concatenate([crowd, others]), np.concatenate([crowd, others + (30, 0)])
    assert share(before, after) == pytest.approx(900 / 925)


def test_a_sign_in_the_picture_of_a_camera_that_moves_is_a_small_share():
    everywhere = middles(range(8), range(8))
    sign = np.random.default_rng(0).uniform((700, 560), (800, 640), (6, 2))
    before = np.concatenate([everywhere, sign])
    after = np.concatenate([everywhere + (15, 3), sign])
    # One cell of 64, or 6 of 70 features.
    assert share(before, after) == pytest.approx(6 / 70)


@pytest.mark.parametrize(("shift", "stays"), [(1.5, 1.0), (1.7, 0.0)])
def test_two_pixels_of_a_thousand_columns_are_no_movement(shift, stays):
    places = middles(range(8), range(8))
    assert share(places, places + (shift, 0)) == stays


def test_features_on_the_border_are_in_the_last_cell():
    places = np.array([[0.0, 0.0], [800.0, 640.0]])
    assert share(places, places) == 1
