"""The terms of the loss that are not about colours, and their weights."""

import dataclasses

import jax
import numpy as np
import toy

from gaussray.camera.array import camera_set
from gaussray.reconstruct.optimize.density import DensityOptions
from gaussray.reconstruct.optimize.loss import LossOptions
from gaussray.reconstruct.optimize.optimizer import OptimizerOptions, Parameters
from gaussray.reconstruct.step_loss import StepOptions, density_costs
from gaussray.scene.gaussians import unconstrain
from gaussray.tracer.trace import TraceOptions


# Sigmoid and exponential of their inverses in single precision.
CLOSE = 1e-6
EXTENT = 2.0
TIMES = toy.single([0.0])
RELOCATE = DensityOptions(kind="relocate", interval=10, opacity_cost=0.01, scale_cost=0.02)


def parameters():
    static = toy.gaussians(np.zeros((2, 3)), 0.1, 0.5)
    moving = toy.gaussians(np.zeros((3, 3)), 0.4, 0.5)
    moving = dataclasses.replace(moving, opacity=toy.single([0.25, 0.5, 0.75]))
    static = dataclasses.replace(static, opacity=toy.single([0.2, 0.4]))
    return Parameters(unconstrain(static), unconstrain(moving), None)


def cameras():
    stack = jax.tree.map(lambda x: x[None], toy.camera(0.0))
    return camera_set(np.arange(1), stack, extent=EXTENT)


def test_opacity_and_scale_cost_their_means_over_the_gaussians_of_all_kinds():
    total, costs = density_costs(parameters(), TIMES, cameras(), RELOCATE)
    opacity = (0.2 + 0.4 + 0.25 + 0.5 + 0.75) / 5
    scale = (2 * 0.1 + 3 * 0.4) / 5 / EXTENT
    np.testing.assert_allclose(costs["opacity_cost"], opacity, rtol=CLOSE)
    np.testing.assert_allclose(costs["scale_cost"], scale, rtol=CLOSE)
    np.testing.assert_allclose(total, 0.01 * opacity + 0.02 * scale, rtol=CLOSE)


def test_a_weight_of_zero_switches_a_cost_off_and_splitting_has_none():
    free = dataclasses.replace(RELOCATE, opacity_cost=0.0)
    assert list(density_costs(parameters(), TIMES, cameras(), free)[1]) == ["scale_cost"]
    total, costs = density_costs(parameters(), TIMES, cameras(), DensityOptions(interval=10))
    assert costs == {} and total == 0


def test_every_term_has_the_weight_of_its_key():
    options = StepOptions(LossOptions(l1=0.8, dssim=0.2), OptimizerOptions(), TraceOptions())
    weights = options.weights()
    assert weights["l1"] == 0.8 and weights["dssim"] == 0.2
