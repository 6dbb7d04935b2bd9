"""Scores against values worked out by hand."""

import math

import numpy as np
import pytest

from gaussray.evaluate.metrics import psnr, ssim


def noise(seed, shape=(20, 24, 3)):
    return np.random.default_rng(seed).random(shape)


def test_psnr_of_a_constant_difference_is_minus_twenty_log_of_it():
    truth = np.full((4, 5, 3), 0.5)
    assert psnr(truth, truth + 0.1) == pytest.approx(20)
    assert psnr(truth, truth - 0.01) == pytest.approx(40)


def test_psnr_of_equal_pictures_is_infinite():
    assert psnr(noise(0), noise(0)) == math.inf


def test_codes_count_in_units_of_255():
    truth = np.zeros((4, 5, 3), np.uint8)
    assert psnr(truth, truth + np.uint8(51)) == pytest.approx(-20 * math.log10(0.2))
    assert psnr(truth, np.full((4, 5, 3), 0.2, np.float32)) == pytest.approx(13.9794, abs=1e-4)


def test_a_mask_limits_what_counts():
    truth, image = np.zeros((4, 5, 3)), np.zeros((4, 5, 3))
    image[0], image[1] = 0.1, 1.0
    mask = np.zeros((4, 5), bool)
    mask[0] = True
    assert psnr(truth, image, mask) == pytest.approx(20)
    assert math.isnan(psnr(truth, image, np.zeros((4, 5), bool)))


def test_ssim_of_equal_pictures_is_one():
    assert ssim(noise(0), noise(0)) == pytest.approx(1)
    assert ssim(noise(0), noise(0), np.ones((20, 24), bool)) == pytest.approx(1)


def test_ssim_of_constant_pictures_is_the_luminance_term_alone():
    a, b, c1 = 0.3, 0.6, 0.01**2
    expected = (2 * a * b + c1) / (a * a + b * b + c1)
    shape = (20, 24, 3)
    assert ssim(np.full(shape, a), np.full(shape, b)) == pytest.approx(expected, rel=1e-9)


def test_ssim_at_a_pixel_is_the_formula_under_its_gaussian_window():
    x, y = noise(1), noise(2)
    offset = np.arange(-5, 6)
    line = np.exp(-(offset**2) / (2 * 1.5**2))
    weight = np.outer(line, line) / line.sum() ** 2
    values = []
    for channel in range(3):
        a, b = (image[5:16, 6:17, channel] for image in (x, y))
        ma, mb = (weight * a).sum(), (weight * b).sum()
        va, vb = (weight * a * a).sum() - ma**2, (weight * b * b).sum() - mb**2
        cov = (weight * a * b).sum() - ma * mb
        c1, c2 = 0.01**2, 0.03**2
        values.append((2 * ma * mb + c1) * (2 * cov + c2) / ((ma**2 + mb**2 + c1) * (va + vb + c2)))
    mask = np.zeros((20, 24), bool)
    mask[10, 11] = True
    assert ssim(x, y, mask) == pytest.approx(np.mean(values), rel=1e-9)


def test_ssim_leaves_out_the_border():
    x, y = noise(1), noise(2)
    mask = np.zeros((20, 24), bool)
    mask[5:-5, 5:-5] = True
    assert ssim(x, y) == pytest.approx(ssim(x, y, mask), rel=1e-12)
    # Nor does it count where a mask has it.
    assert ssim(x, y, np.ones((20, 24), bool)) == pytest.approx(ssim(x, y), rel=1e-12)
    assert math.isnan(ssim(x, y, np.zeros((20, 24), bool)))


def test_pictures_that_cannot_be_compared_are_refused():
    with pytest.raises(ValueError, match=r"of one size, got \(20, 24, 3\) and \(4, 5, 3\)"):
        psnr(noise(0), np.zeros((4, 5, 3)))
    with pytest.raises(ValueError, match=r"mask must have the pictures' size \(20, 24\)"):
        psnr(noise(0), noise(0), np.ones((4, 5), bool))
    with pytest.raises(ValueError, match="sides of at least 11 pixels, got 5 x 4"):
        ssim(np.zeros((4, 5, 3)), np.zeros((4, 5, 3)))
    with pytest.raises(ValueError, match="must be uint8 or floats, got int64"):
        psnr(np.zeros((4, 5, 3), int), np.zeros((4, 5, 3), int))
