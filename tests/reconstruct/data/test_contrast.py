"""Opacity costs less for pictures of little contrast."""

import numpy as np
import pytest
import toy

from gaussray.reconstruct.data.contrast import contrast_of, cost_at_contrast
from gaussray.reconstruct.optimize.density import DensityOptions


SIZE, FRAMES = 32, 3
# Sums of single precision.
CLOSE = 1e-5


def bright_part(share, level):
    """Black pictures of whose rows a share has a grey level."""
    pictures = np.zeros((FRAMES, SIZE, SIZE, 3), np.uint8)
    pictures[:, : int(share * SIZE)] = level
    return pictures


def test_contrast_is_the_mean_difference_from_the_median():
    found = contrast_of(toy.footage_of(bright_part(0.25, 102)))
    assert found == pytest.approx(0.25 * 0.4, abs=CLOSE)
    dice = np.random.default_rng(0)
    pictures = dice.random((FRAMES, SIZE, SIZE, 3)).astype(np.float32)
    expected = np.abs(pictures - np.median(pictures, axis=(0, 1, 2))).mean()
    assert contrast_of(toy.footage_of(pictures)) == pytest.approx(expected, abs=CLOSE)


def test_masked_pixels_have_no_contrast():
    pictures = bright_part(0.5, 255)
    seen = np.zeros((FRAMES, SIZE, SIZE), bool)
    seen[:, : SIZE // 2] = True
    assert contrast_of(toy.footage_of(pictures, seen)) == 0
    assert contrast_of(toy.footage_of(pictures, ~seen & False)) == 0


def test_lamps_brighter_than_white_are_white_and_what_is_no_number_is_black():
    pictures = bright_part(0.25, 255) / 255
    brighter = np.where(pictures > 0, 7.0, pictures)
    brighter[:, -1] = np.nan
    assert contrast_of(toy.footage_of(brighter)) == pytest.approx(0.25, abs=CLOSE)


def test_opacity_costs_less_in_proportion_to_little_contrast_but_no_less_than_the_default():
    least = DensityOptions().opacity_cost
    assert cost_at_contrast(0.12, 0.15) == cost_at_contrast(0.12, 0.4) == 0.12
    assert cost_at_contrast(0.12, 0.03) == pytest.approx(0.12 * 0.2)
    assert cost_at_contrast(0.12, 0.0) == least
    # What is set lower stays.
    assert cost_at_contrast(least / 4, 0.03) == least / 4
    assert cost_at_contrast(0.0, 0.03) == 0
