"""What cameras are compared by: blocks of pixels, and how they change with every unknown."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.alignment import Aligner, sights
from gaussray.camera.lens import KannalaBrandt
from gaussray.color import srgb_encode
from gaussray.fit.unknowns import KINDS, units, unknowns


pytestmark = pytest.mark.usefixtures("quick_compilation")

SIDE = 24
# Central differences of 1e-4 in double precision: key states follow the times of the rays, which no
# slope knows of.
STEP, SLOPE = 1e-4, 1e-2
# No cut-offs: what is seen is smooth.
SMOOTH = dataclasses.replace(toy.TRACE, alpha_min=1e-6, transmittance_min=0.0)


def fisheye():
    """A camera with a lens of some distortion and a rolling shutter, in double precision."""
    camera = toy.rolling(toy.camera(0.2, 0.5, SIDE, SIDE), 0.3)
    middle = toy.single([SIDE / 2] * 2)
    lens = KannalaBrandt(2 * middle, middle, toy.single([0.05, -0.01, 0, 0]), toy.single(1.2))
    return jax.tree.map(lambda x: jnp.asarray(x, float), dataclasses.replace(camera, lens=lens))


SCENE = jax.tree.map(lambda x: jnp.asarray(x, float), toy.scene())
CAMERA = fisheye()
TOLD = unknowns(KINDS, CAMERA.lens)
UNIT = units(CAMERA)


@pytest.fixture(scope="module")
def align():
    return Aligner(TOLD, samples=1, trace=SMOOTH, bend=1e9)


def agreement(align, value, sight):
    return align(SCENE, CAMERA, UNIT, sight, value, 1.0, keys=3)


def test_the_mean_of_a_block_is_that_of_its_pixels():
    light = np.random.default_rng(0).uniform(size=(20, 12, 3))
    mask = np.ones((20, 12), bool)
    mask[:3, :5] = False
    (sight,) = sights(light, mask, 4, bundle=8)
    pixel, weight = np.asarray(sight.pixel, int), np.asarray(sight.weight) > 0
    # Tiles of 8 x 8 rays hold 2 x 2 blocks of 4 x 4.
    block = np.arange(len(weight)).reshape(-1, 2, 4, 2, 4).swapaxes(2, 3).reshape(-1, 16)
    for slots, truth in zip(block, sight.truth, strict=True):
        if weight[slots].any():
            column, row = 4 * (pixel[slots[weight[slots]][0]] // 4)
            own = slice(row, row + 4), slice(column, column + 4)
            np.testing.assert_allclose(truth, srgb_encode(light[own][mask[own]].mean(axis=0)))
    assert weight.sum() == mask.sum()


@pytest.mark.parametrize("factor", [1, 4])
def test_slopes_are_those_of_differences(align, factor):
    rng = np.random.default_rng(1)
    light, mask = rng.uniform(size=(SIDE, SIDE, 3)), np.ones((SIDE, SIDE), bool)
    (sight,) = sights(light, mask, factor, bundle=8)
    value = 0.02 * rng.standard_normal(len(TOLD))
    found = agreement(align, value, sight)
    ways = STEP * np.eye(len(TOLD))
    ahead, behind = (
        np.stack([agreement(align, value + sign * way, sight).residual for way in ways])
        for sign in (1, -1)
    )
    change = ((ahead - behind) / (2 * STEP)).reshape(len(TOLD), -1)
    curvature = change @ change.T
    size = np.sqrt(np.diag(curvature))
    gradient = change @ found.residual.reshape(-1)
    error = np.linalg.norm(found.residual)
    np.testing.assert_allclose(found.gradient / size / error, gradient / size / error, atol=SLOPE)
    unit = np.outer(size, size)
    np.testing.assert_allclose(found.curvature / unit, curvature / unit, atol=SLOPE)
