"""Residuals of pixel blocks and their derivatives by every unknown."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.calibrate.parameters import unit_camera_set, unknowns
from gaussray.calibrate.pixel_blocks import pixel_blocks
from gaussray.calibrate.residuals import CameraEstimate, ResidualEvaluator


SIDE = 16
# Central differences of 1e-4 in double precision, in units of the columns: the order of overlapping
# Gaussians changes on the way in a few pixels, where what is seen jumps.
STEP, SLOPE = 1e-4, 0.03
# No cut-offs: what is seen is smooth.
SMOOTH = dataclasses.replace(toy.TRACE, alpha_min=1e-6, transmittance_min=0.0)


SCENE = jax.tree.map(lambda x: jnp.asarray(x, float), toy.scene(speed=0))
CAMERA = jax.tree.map(lambda x: jnp.asarray(x, float), toy.camera(0.2, 0.5, SIDE, SIDE))
UNKNOWNS = unknowns(("focal", "lens", "pose", "exposure"), CAMERA.lens)
UNIT = unit_camera_set(CAMERA)


@pytest.fixture(scope="module")
def evaluator():
    return ResidualEvaluator(samples=1, trace=SMOOTH, bend=1e9)


def equations(evaluator, value, blocks):
    estimate = CameraEstimate(CAMERA, UNIT, UNKNOWNS, jnp.asarray(value))
    return evaluator(SCENE, estimate, blocks, 1.0, keys=1)


@pytest.mark.ci
def test_slopes_are_those_of_differences(evaluator):
    rng = np.random.default_rng(1)
    light, mask = rng.uniform(size=(SIDE, SIDE, 3)), np.ones((SIDE, SIDE), bool)
    (blocks,) = pixel_blocks(light, mask, 2, bundle=8)
    value = 0.02 * rng.standard_normal(len(UNKNOWNS))
    found = equations(evaluator, value, blocks)
    ways = STEP * np.eye(len(UNKNOWNS))
    ahead, behind = (
        np.stack([equations(evaluator, value + sign * way, blocks).residual for way in ways])
        for sign in (1, -1)
    )
    change = ((ahead - behind) / (2 * STEP)).reshape(len(UNKNOWNS), -1)
    curvature = change @ change.T
    size = np.sqrt(np.diag(curvature))
    gradient = change @ found.residual.reshape(-1)
    error = np.linalg.norm(found.residual)
    np.testing.assert_allclose(found.gradient / size / error, gradient / size / error, atol=SLOPE)
    unit = np.outer(size, size)
    np.testing.assert_allclose(found.curvature / unit, curvature / unit, atol=SLOPE)
