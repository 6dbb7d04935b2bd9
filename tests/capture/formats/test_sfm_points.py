"""Sparse points of structure-from-motion projects."""

from pathlib import Path

import numpy as np
import pytest

from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.sfm_points import given_points


TOP = Keys(Path("file"), {})


def test_numbers_may_be_texts_and_colours_are_decoded():
    points = given_points(TOP, "points", [["1", "-2.5", "3"]], [[0, 255, "128"]])
    assert points is not None
    np.testing.assert_allclose(points.position, [[1, -2.5, 3]])
    np.testing.assert_allclose(points.color, [[0, 1, ((128 / 255 + 0.055) / 1.055) ** 2.4]])
    assert points.color.dtype == points.position.dtype == np.float32


def test_points_without_colours_are_gray():
    with pytest.warns(CaptureWarning, match="file: its points have no colour; all are gray 0.5"):
        points = given_points(TOP, "points", [[1, 2, 3]], None)
    assert points is not None and (points.color == 0.5).all()
    assert given_points(TOP, "points", [], None) is None


@pytest.mark.parametrize(
    "wrong", [None, [1, 2], [1, 2, "x"], [1, 2, float("nan")], [0, 1e39, 0], [1, 2, True]]
)
def test_a_point_that_is_none_is_named(wrong):
    with pytest.raises(CaptureError, match="file, point 1: points: position must be three finite"):
        given_points(TOP, "points", [[1, 2, 3], wrong], None)


def test_a_colour_outside_of_eight_bits_is_named():
    with pytest.raises(CaptureError, match="point 1: points: color must be from 0 to 255"):
        given_points(TOP, "points", [[1, 2, 3]] * 2, [[1, 2, 3], [1, 2, 256]])
    with pytest.raises(CaptureError, match="point 1: points: color must be three finite numbers"):
        given_points(TOP, "points", [[1, 2, 3]] * 2, [[1, 2, 3], [True, False, True]])
