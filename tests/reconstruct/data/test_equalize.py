"""Exposures and light that change over time are found, told apart, and evened out."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.color import srgb_decode, srgb_encode
from gaussray.reconstruct.data.equalize import Equalization, equalization, equalized
from gaussray.reconstruct.data.pictures import Footage
from gaussray.reconstruct.data.tiles import cut, tile_pixels
from gaussray.scene.light import Light


SIZE, SIDE, TIMES = 24, 8, 9
# Pictures of 8 bits: half a level of a dark pixel is some percent of its light, and means over
# hundreds of pixels are ten times as good.
CLOSE = 0.01
# A level of 255 and a half: rounded twice.
TWICE_ROUNDED = 1.5 / 255


def waves(seed, amount):
    """A smooth gain over time of each channel, with a median of 1."""
    phase = np.random.default_rng(seed).uniform(0, 6, 3)
    log_gain = amount * np.sin(np.arange(TIMES)[:, None] + phase)
    return np.exp(log_gain - np.median(log_gain, axis=0))


def filmed(gains, *, turning=False, moving=0.3, dtype=np.uint8, seed=0):
    """Footage of one camera for each gain (times, 3), of random pictures, a share of which is
    something else at each time; and the pictures in usual light."""
    dice = np.random.default_rng(seed)
    pictures, usual, cameras, names = [], [], [], []
    for number, gain in enumerate(gains):
        still = dice.uniform(0.05, 0.5, (SIZE, SIZE, 3))
        for time in range(TIMES):
            columns = slice(int((1 - moving) * SIZE), None)
            light = still.copy()
            light[:, columns] = dice.uniform(0.05, 0.5, light[:, columns].shape)
            usual.append(srgb_encode(light))
            encoded = np.clip(srgb_encode(light * gain[time]), 0, 1)
            pictures.append(
                np.rint(255 * encoded).astype(np.uint8)
                if dtype == np.uint8
                else encoded.astype(dtype)
            )
            cameras.append(
                toy.camera(0.1 * time * turning + number, float(time), width=SIZE, height=SIZE)
            )
            names.append(f"camera {number}")
    camera = jax.tree.map(lambda *x: jnp.stack(x), *cameras)
    pixels = tile_pixels(camera.film, SIDE)
    footage = Footage(
        np.stack([cut(p, pixels) for p in pictures]), None, camera, np.array(names), SIDE
    )
    return footage, np.stack([cut(p, pixels) for p in usual])


CONSTANT = np.ones((TIMES, 3))


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_light_that_cameras_share_is_found_and_taken_away(dtype):
    lamp = waves(0, 0.3)
    footage, usual = filmed([lamp, lamp, lamp], dtype=dtype)
    found = equalization(footage)
    np.testing.assert_allclose(found.light.at(jnp.arange(1.0 * TIMES)), lamp, rtol=CLOSE)
    np.testing.assert_array_equal(found.exposure, 1)
    even = equalized(footage, found).pixel / footage.scale
    assert np.quantile(np.abs(even - usual), 0.99) < TWICE_ROUNDED + CLOSE


def test_exposures_of_the_cameras_are_no_light():
    gains = [waves(seed, 0.3) for seed in (1, 2, 3, 4)]
    footage, _ = filmed(gains)
    found = equalization(footage)
    assert found.light is None
    np.testing.assert_allclose(found.exposure, np.concatenate(gains), rtol=CLOSE)


def test_one_cameras_exposure_beside_the_light():
    lamp, own = waves(0, 0.3), waves(5, 0.2)
    # What is usual of a camera is the median of both.
    own /= np.median(lamp * own, axis=0)
    footage, _ = filmed([lamp, lamp * own, lamp])
    found = equalization(footage)
    np.testing.assert_allclose(found.light.gain, lamp, rtol=CLOSE)
    np.testing.assert_allclose(found.exposure[TIMES : 2 * TIMES], own, rtol=CLOSE)
    np.testing.assert_array_equal(found.exposure[:TIMES], 1)


@pytest.mark.parametrize(
    "case",
    [
        {"gains": [CONSTANT] * 3},
        {"gains": [waves(0, 0.01)] * 3},
        # Bodies that fill most of the picture tell nothing.
        {"gains": [waves(0, 0.3)] * 3, "moving": 0.8},
        # The pictures of a camera that moves show other things.
        {"gains": [waves(0, 0.3)] * 3, "turning": True},
    ],
)
def test_nothing_is_found_where_nothing_changes_or_nothing_tells(case):
    assert equalization(filmed(**case)[0]) is None


def test_what_is_at_full_scale_stays_there():
    footage, _ = filmed([waves(0, 0.3)])
    footage.pixel[:] = np.arange(256, dtype=np.uint8)[
        np.random.default_rng(0).integers(200, 256, footage.pixel.shape)
    ]
    before = footage.pixel.copy()
    bright = np.broadcast_to([1.5, 1.5, 1.5], (TIMES, 3))
    after = equalized(footage, Equalization(bright, None)).pixel
    np.testing.assert_array_equal(after[before == 255], 255)
    light = srgb_decode(before / 255.0)
    expected = np.where(before == 255, 1, light / 1.5)
    np.testing.assert_allclose(srgb_decode(after / 255.0), expected, atol=1 / 255)


def test_the_sentence_names_what_changes_and_the_key():
    own = np.array([[1.0] * 3, [2.0] * 3])
    said = "Changes over time, evened out (fit.equalize): "
    assert Equalization(own, None).sentence == f"{said}exposures by up to 1.0 stops."
    lamp = Light(jnp.arange(2.0), jnp.asarray(own**2))
    assert Equalization(np.ones((2, 3)), lamp).sentence == f"{said}the light by up to 2.0 stops."
