"""What cameras are compared by: blocks of pixels, and how they change with every unknown."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.alignment import Aligner, sights
from gaussray.camera.lens import KannalaBrandt
from gaussray.color import srgb_encode
from gaussray.fit.unknowns import KINDS, applied, units, unknowns
from gaussray.render import Renderer, RenderOptions


pytestmark = pytest.mark.usefixtures("quick_compilation")

SIDE = 24
# Central differences of 1e-4 in double precision, of a function that jumps where a Gaussian begins.
STEP, SLOPE = 1e-4, 2e-3
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
    first = 0
    for tile in range(sight.weight.shape[0] // 64):
        for by in range(2):
            for bx in range(2):
                block = 4 * tile + 2 * by + bx
                slots = (
                    64 * tile + np.arange(64).reshape(8, 8)[4 * by : 4 * by + 4, 4 * bx :][:, :4]
                )
                seen = np.asarray(sight.pixel[slots.ravel()], int)[
                    np.asarray(sight.weight[slots.ravel()]) > 0
                ]
                if not len(seen):
                    continue
                column, row = 4 * (seen[0] // 4)
                part = light[row : row + 4, column : column + 4][
                    mask[row : row + 4, column : column + 4]
                ]
                np.testing.assert_allclose(sight.truth[block], srgb_encode(part.mean(axis=0)))
                first += len(seen)
    assert first == mask.sum()


@pytest.mark.parametrize("factor", [1, 4])
def test_slopes_are_those_of_differences(align, factor):
    rng = np.random.default_rng(1)
    light, mask = rng.uniform(size=(SIDE, SIDE, 3)), np.ones((SIDE, SIDE), bool)
    (sight,) = sights(light, mask, factor, bundle=8)
    value = 0.02 * rng.standard_normal(len(TOLD))
    found = agreement(align, value, sight)
    for i in range(len(TOLD)):
        ahead, behind = (
            agreement(align, value + sign * STEP * np.eye(len(TOLD))[i], sight).residual
            for sign in (1, -1)
        )
        change = (ahead - behind) / (2 * STEP)
        np.testing.assert_allclose(
            found.gradient[i], np.sum(change * found.residual), rtol=SLOPE, atol=SLOPE
        )
        np.testing.assert_allclose(found.curvature[i, i], np.sum(change**2), rtol=SLOPE)
