"""Blocks of pixels: their mean colours and the rays that sample them."""

import numpy as np

from gaussray.calibrate.pixel_blocks import pixel_blocks
from gaussray.color import srgb_encode


def test_the_mean_of_a_block_is_that_of_its_pixels():
    light = np.random.default_rng(0).uniform(size=(20, 12, 3))
    mask = np.ones((20, 12), bool)
    mask[:3, :5] = False
    (blocks,) = pixel_blocks(light, mask, 4, bundle=8)
    pixel, weight = np.asarray(blocks.pixel, int), np.asarray(blocks.weight) > 0
    # Tiles of 8 x 8 rays hold 2 x 2 blocks of 4 x 4.
    slots_of = np.arange(len(weight)).reshape(-1, 2, 4, 2, 4).swapaxes(2, 3).reshape(-1, 16)
    for slots, truth in zip(slots_of, blocks.truth, strict=True):
        if weight[slots].any():
            column, row = 4 * (pixel[slots[weight[slots]][0]] // 4)
            region = slice(row, row + 4), slice(column, column + 4)
            np.testing.assert_allclose(truth, srgb_encode(light[region][mask[region]].mean(axis=0)))
    assert weight.sum() == mask.sum()
