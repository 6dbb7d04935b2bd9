"""What pixels look like, against SciPy's filter."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from gaussray.color import srgb_decode
from gaussray.reconstruct.initialize.appearance import CHANGES, Shown, layers, look


# Single precision of sums over some ten pixels.
ROUNDING = 2e-6
BLUR = (2.0, 0.5)


@pytest.fixture
def shown():
    rng = np.random.default_rng(0)
    picture = rng.integers(0, 256, (2, 37, 50, 3), dtype=np.uint8)
    return Shown(picture, rng.random((2, 37, 50)) < 0.3, rng.random((2, 37, 50)) < 0.9)


def shrunk(picture, factor):
    frames, height, width = picture.shape[:3]
    height, width = height // factor, width // factor
    block = picture[:, : height * factor, : width * factor].astype(np.float64)
    return block.reshape(frames, height, factor, width, factor, -1).mean(axis=(2, 4))


@pytest.mark.parametrize("shrink", [1, 3])
@pytest.mark.parametrize("kind", [np.uint8, np.float32])
def test_layers_are_blurred_as_by_scipy(shown, shrink, kind):
    picture = shown.picture if kind == np.uint8 else (shown.picture / 255).astype(kind)
    light = srgb_decode(shrunk(shown.picture, shrink) / 255)
    changes = CHANGES * shrunk(shown.moved[..., None], shrink)
    sharp = np.concatenate([look(light), changes], axis=-1)
    found = layers(shown._replace(picture=picture, visible=None), shrink, BLUR)
    for layer, sigma in zip(found, BLUR, strict=True):
        expected = gaussian_filter(sharp, (0, sigma, sigma, 0))
        np.testing.assert_allclose(layer, expected, atol=ROUNDING)


def test_a_block_with_a_hidden_pixel_is_not_a_number(shown):
    hidden = shrunk(~shown.visible[..., None], 3)[..., 0] > 0
    assert 0 < hidden.sum() < hidden.size
    for layer in layers(shown, 3, BLUR):
        np.testing.assert_array_equal(np.isnan(layer).all(axis=-1), hidden)


def test_a_pixel_that_is_not_a_number_leaves_the_rest_of_its_picture(shown):
    picture = (shown.picture / 255).astype(np.float32)
    picture[0, 20, 20] = np.nan
    picture[1, 3, 4] = np.inf
    black = np.where(np.isfinite(picture), picture, 0)
    found, expected = (
        layers(Shown(pixels, shown.moved, None), 1, BLUR) for pixels in (picture, black)
    )
    for layer, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(layer, other, atol=ROUNDING)
