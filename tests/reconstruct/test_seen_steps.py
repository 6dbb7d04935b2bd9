"""A step of few tiles traces what they may meet alone: loss and gradients are those of all."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.camera.array import camera_set
from gaussray.reconstruct.data.batches import Batch
from gaussray.reconstruct.optimize.learning_rates import OptimizerOptions
from gaussray.reconstruct.optimize.loss import LossOptions
from gaussray.reconstruct.optimize.optimizer import Parameters
from gaussray.reconstruct.optimize.state import begin_state
from gaussray.reconstruct.step import measure_sizes
from gaussray.reconstruct.step_loss import StepOptions, loss_of
from gaussray.scene.gaussians import unconstrain
from gaussray.tracer.options import TraceOptions
from gaussray.tracer.shard import mesh


# Of single precision: sums of the same numbers, in another order at most.
SAME = 1e-6
COUNT, SIDE = 400, 8
OPTIONS = StepOptions(
    LossOptions(l1=1.0, dssim=0.0), OptimizerOptions(), TraceOptions(bundle=4, k=8, levels=0)
)


@pytest.fixture(scope="module")
def problem():
    """A state of Gaussians all over the picture, two of its 64 tiles, and their sizes."""
    camera = jax.tree.map(lambda x: x[None], toy.camera(0.0, 0.0, 64, 64))
    dice = np.random.default_rng(0)
    crowd = toy.gaussians(dice.uniform(-1.0, 1.0, (COUNT, 3)), 0.03, 0.6, opacity=0.7)
    none = unconstrain(jax.tree.map(lambda x: x[:0], crowd))
    state = begin_state(Parameters(unconstrain(crowd), none, None))
    colors = dice.integers(0, 255, (1, 2, SIDE**2, 3)).astype(np.uint8)
    batches = Batch(
        jnp.zeros((1, 2), jnp.int32),
        jnp.asarray([[27, 36]], jnp.int32),
        toy.single([0.0]),
        jnp.asarray(colors),
        None,
    )
    cameras = camera_set(np.arange(1), camera, extent=2.0)
    sizes = measure_sizes(state, camera, batches, cameras, options=OPTIONS, mesh=mesh(1))
    return state, camera, jax.tree.map(lambda x: x[0], batches), cameras, sizes


@eqx.filter_jit
def slope(state, camera, batch, cameras, sizes):
    loss = jax.value_and_grad(loss_of, has_aux=True)
    return loss(state.parameters, camera, batch, cameras, state.step, options=OPTIONS, sizes=sizes)


def test_loss_and_gradients_are_those_of_all_gaussians(problem):
    *parts, sizes = problem
    assert sizes.seen and sizes.seen[0] < 0.5 * COUNT
    # Lists for all Gaussians are longer than for those that are seen.
    capacity = dataclasses.replace(sizes.capacity, cells=(COUNT,), pairs=COUNT * 8, slots=COUNT)
    whole = dataclasses.replace(sizes, capacity=capacity, seen=None)
    (value, details), gradient = slope(*parts, sizes)
    (expected, other), known = slope(*parts, whole)
    assert int(details.report.dropped) == int(other.report.dropped) == 0
    assert float(details.report.hits) == float(other.report.hits) > 0
    np.testing.assert_allclose(value, expected, rtol=SAME)
    for x, y in zip(*map(jax.tree.leaves, (gradient, known)), strict=True):
        np.testing.assert_allclose(x, y, rtol=0, atol=SAME * max(np.abs(y).max(initial=0), 1e-6))
    assert float(jnp.abs(known.static.mean).max()) > 0


def test_a_step_without_places_for_all_that_it_sees_says_so_and_gets_them(problem):
    *parts, sizes = problem
    small = dataclasses.replace(sizes, seen=(16, 1))
    (_, details), _ = slope(*parts, small)
    assert int(details.report.dropped) > 0
    larger = small.enlarged(np.asarray(details.report.needed))
    (_, again), _ = slope(*parts, larger)
    assert int(again.report.dropped) == 0
    # What is large enough already stays, so that nothing compiles again.
    assert larger.capacity == sizes.capacity
