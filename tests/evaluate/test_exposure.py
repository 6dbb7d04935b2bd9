"""Renderings as a camera records them, and PSNR after the best gain, against closed forms."""

import math

import numpy as np
import pytest

from gaussray.color import srgb_decode, srgb_encode
from gaussray.dataset.images import srgb_levels
from gaussray.evaluate.exposure import exposure_match, recorded_levels
from gaussray.evaluate.metrics import psnr


SHAPE = (12, 16, 3)
# Rounding to levels: the gain is found to a hundredth of a stop, and errors are below one level.
STOPS, ROUNDED = 0.01, 48.0


@pytest.fixture
def image():
    return np.random.default_rng(0).integers(40, 200, SHAPE).astype(np.uint8)


def brightened(image, gain):
    return srgb_levels(np.asarray(gain) * srgb_decode(image / 255))


def test_a_gain_acts_on_linear_light_and_a_matrix_mixes_channels():
    light = np.full(SHAPE, 0.2, np.float32)
    level = round(255 * float(srgb_encode(np.array(0.4))))
    assert np.all(recorded_levels(light, 2 * np.eye(3)) == level)
    assert np.array_equal(recorded_levels(light, None), srgb_levels(light))
    red = light * np.float32([1, 0, 0])
    to_green = np.array([[0, 0, 0], [2, 0, 0], [0, 0, 0]], np.float64)
    assert np.all(recorded_levels(red, to_green) == [0, level, 0])


def test_what_a_gain_of_each_channel_explains_is_no_error(image):
    truth = brightened(image, [0.5, 0.8, 1.2])
    found = exposure_match(truth, image)
    assert psnr(truth, image) < 30 and found.psnr > ROUNDED


@pytest.mark.parametrize("stops", [-1.0, 0.0, 0.5])
def test_stops_are_those_by_which_the_picture_is_lighter(image, stops):
    found = exposure_match(brightened(image, 2.0**stops), image)
    assert found.stops == pytest.approx(stops, abs=STOPS)


def test_an_offset_is_not_explained(image):
    light = srgb_decode(image / 255)
    truth = srgb_levels(light + 0.1)
    gain = np.sum((light + 0.1) * light, axis=(0, 1)) / np.sum(light**2, axis=(0, 1))
    expected = psnr(truth, srgb_levels(gain * light))
    assert exposure_match(truth, image).psnr == pytest.approx(expected, abs=0.05)
    assert expected < 35


def test_pixels_that_do_not_count_change_nothing(image):
    truth, mask = brightened(image, 0.5), np.zeros(SHAPE[:2], bool)
    mask[:, :9] = True
    spoilt = truth.copy()
    spoilt[~mask] = 255
    assert exposure_match(spoilt, image, mask) == exposure_match(truth, image, mask)
    assert exposure_match(spoilt, image).psnr < ROUNDED


def test_black_pictures_have_no_gain(image):
    black = np.zeros_like(image)
    assert math.isnan(exposure_match(image, black).stops)
    assert exposure_match(image, black).psnr == psnr(image, black)
    dark = exposure_match(black, image)
    assert math.isnan(dark.stops) and dark.psnr == math.inf
    nothing = exposure_match(image, image, np.zeros(SHAPE[:2], bool))
    assert math.isnan(nothing.psnr) and math.isnan(nothing.stops)
