"""What cameras are compared by: blocks of pixels, and how they change with every unknown."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.calibrate.parameters import units, unknowns
from gaussray.calibrate.residuals import Aligner, sights
from gaussray.color import srgb_encode


pytestmark = pytest.mark.usefixtures("quick_compilation")

SIDE = 16
# Central differences of 1e-4 in double precision, in units of the columns: the order of overlapping
# Gaussians changes on the way in a few pixels, where what is seen jumps.
STEP, SLOPE = 1e-4, 0.03
# No cut-offs: what is seen is smooth.
SMOOTH = dataclasses.replace(toy.TRACE, alpha_min=1e-6, transmittance_min=0.0)


SCENE = jax.tree.map(lambda x: jnp.asarray(x, float), toy.scene(speed=0))
CAMERA = jax.tree.map(lambda x: jnp.asarray(x, float), toy.camera(0.2, 0.5, SIDE, SIDE))
TOLD = unknowns(("focal", "lens", "pose", "exposure"), CAMERA.lens)
UNIT = units(CAMERA)


@pytest.fixture(scope="module")
def align():
    return Aligner(TOLD, samples=1, trace=SMOOTH, bend=1e9)


def agreement(align, value, sight):
    return align(SCENE, CAMERA, UNIT, sight, value, 1.0, keys=1)


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


def test_slopes_are_those_of_differences(align):
    rng = np.random.default_rng(1)
    light, mask = rng.uniform(size=(SIDE, SIDE, 3)), np.ones((SIDE, SIDE), bool)
    (sight,) = sights(light, mask, 2, bundle=8)
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
