"""Plain backdrops are told by the pictures' borders, whatever stands before them; only what is as
dark as a black one shows nothing."""

import re

import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.color import srgb_encode
from gaussray.reconstruct.data.backdrop import (
    backdrop_of,
    backdrop_sentence,
    before_backdrop,
    like_backdrop,
)


SIZE, FRAMES = 32, 3
# A colour of single precision.
CLOSE = 1e-6


def thing_before(color, noise=0):
    """A textured thing in the middle of pictures of one colour, give or take some levels."""
    dice = np.random.default_rng(0)
    pictures = np.full((FRAMES, SIZE, SIZE, 3), color, int)
    pictures += dice.integers(-noise, noise + 1, pictures.shape)
    pictures[:, 6:-6, 6:-6] = dice.integers(0, 255, (FRAMES, SIZE - 12, SIZE - 12, 3))
    return np.clip(pictures, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("color", [(0, 0, 0), (255, 255, 255), (20, 180, 40)])
def test_the_colour_of_the_borders_is_the_backdrop(color):
    found = backdrop_of(toy.footage_of(thing_before(color, noise=2)))
    assert np.abs(np.array(found) - np.array(color) / 255).max() < 1.01 / 255
    floats = (thing_before(color) / 255).astype(np.float32)
    np.testing.assert_allclose(
        backdrop_of(toy.footage_of(floats)), np.array(color) / 255, atol=CLOSE
    )


def test_pictures_of_a_room_have_none():
    dice = np.random.default_rng(1)
    pictures = dice.integers(0, 255, (FRAMES, SIZE, SIZE, 3)).astype(np.uint8)
    assert backdrop_of(toy.footage_of(pictures)) is None


def test_masked_pixels_do_not_count():
    pictures = thing_before((0, 0, 0))
    pictures[:, :, : 3 * SIZE // 4] = 200
    masks = np.ones((FRAMES, SIZE, SIZE), bool)
    masks[:, :, : 3 * SIZE // 4] = False
    assert min(backdrop_of(toy.footage_of(pictures))) > 0.5
    assert backdrop_of(toy.footage_of(pictures, masks)) == (0, 0, 0)
    assert backdrop_of(toy.footage_of(pictures, masks & False)) is None


def test_only_what_hardly_differs_from_the_backdrop_is_like_it():
    levels = np.array([[0, 0, 0], [3, 2, 3], [0, 0, 4], [40, 0, 0]]) / 255
    for plain in ((0.0, 0.0, 0.0), (0.9, 0.5, 0.1)):
        found = like_backdrop(levels + np.array(plain), plain)
        assert list(found) == [True, True, False, False]
        on_device = like_backdrop(jnp.asarray(levels + np.array(plain)), plain)
        np.testing.assert_array_equal(found, on_device)


def test_the_rest_of_a_ray_ends_at_the_backdrop():
    color, rest = np.array([[0.2, 0.1, 0.0], [0.0, 0.0, 0.0]]), np.array([0.25, 1.0])
    plain = (1.0, 0.5, 0.0)
    seen = before_backdrop(jnp.asarray(color), jnp.asarray(rest), plain)
    # sRGB 1/2 is 0.2140 of the light.
    np.testing.assert_allclose(seen[0], [0.45, 0.1 + 0.25 * 0.214041, 0.0], atol=CLOSE)
    np.testing.assert_allclose(srgb_encode(np.asarray(seen[1])), plain, atol=CLOSE)


@pytest.mark.parametrize(
    ("plain", "color"),
    [
        ((0.0, 0.01, 0.0), "is black: that"),
        ((1.0, 1.0, 0.99), "is white: that"),
        ((0.2, 0.8, 0.4), r"is of one colour \(sRGB 51 204 102\): that"),
    ],
)
def test_a_sentence_tells_its_colour(plain, color):
    assert re.search(f"border {color} .*loss.backdrop_opacity", backdrop_sentence(plain))
