"""The terms of the loss that are not about colours, and their weights."""

import dataclasses

import jax
import numpy as np
import toy

from gaussray.camera.array import camera_set
from gaussray.reconstruct.optimize.density import DensityOptions
from gaussray.reconstruct.optimize.loss import LossOptions
from gaussray.reconstruct.optimize.optimizer import OptimizerOptions, Parameters
from gaussray.reconstruct.step_loss import StepOptions, density_terms
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


def test_relocation_adds_mean_opacity_and_mean_scale_of_both_parts():
    terms = density_terms(parameters(), TIMES, cameras(), RELOCATE)
    np.testing.assert_allclose(terms["opacity_cost"], 0.3 + 0.5, rtol=CLOSE)
    np.testing.assert_allclose(terms["scale_cost"], (0.1 + 0.4) / EXTENT, rtol=CLOSE)


def test_a_weight_of_zero_switches_a_cost_off_and_splitting_has_none():
    free = dataclasses.replace(RELOCATE, opacity_cost=0.0)
    assert list(density_terms(parameters(), TIMES, cameras(), free)) == ["scale_cost"]
    assert density_terms(parameters(), TIMES, cameras(), DensityOptions(interval=10)) == {}


def test_every_term_has_the_weight_of_its_key():
    options = StepOptions(
        LossOptions(l1=0.8, dssim=0.2), OptimizerOptions(), TraceOptions(), density=RELOCATE
    )
    weights = options.weights()
    assert weights["l1"] == 0.8 and weights["dssim"] == 0.2
    assert weights["opacity_cost"] == 0.01 and weights["scale_cost"] == 0.02
    terms = density_terms(parameters(), TIMES, cameras(), RELOCATE)
    total = sum(weights[name] * float(term) for name, term in terms.items())
    np.testing.assert_allclose(total, 0.01 * 0.8 + 0.02 * 0.25, rtol=CLOSE)
