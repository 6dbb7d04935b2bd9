"""The terms of the loss that are not about colours, and their weights."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import toy

from gaussray.camera.array import camera_set
from gaussray.reconstruct.data.batches import Batch
from gaussray.reconstruct.data.tiles import tile_order
from gaussray.reconstruct.optimize.density import DensityOptions
from gaussray.reconstruct.optimize.learning_rates import OptimizerOptions
from gaussray.reconstruct.optimize.loss import LossOptions
from gaussray.reconstruct.optimize.optimizer import Parameters
from gaussray.reconstruct.optimize.state import begin_state
from gaussray.reconstruct.step import measure_sizes
from gaussray.reconstruct.step_loss import StepOptions, density_costs, loss_of
from gaussray.render.options import RenderOptions
from gaussray.render.renderer import Renderer
from gaussray.scene.gaussians import unconstrain
from gaussray.scene.scene import Scene
from gaussray.tracer.options import TraceOptions
from gaussray.tracer.shard import mesh


# Sigmoid and exponential of their inverses in single precision.
CLOSE = 1e-6
EXTENT = 2.0
TIMES = toy.single([0.0])
RELOCATE = DensityOptions(kind="relocate", interval=10, opacity_cost=0.01, scale_cost=0.02)
NO_PLANES = {"plane_variation": 0.0, "time_smoothness": 0.0, "time_planes_from_one": 0.0}


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
    weights = options.loss.weights
    assert weights["l1"] == 0.8 and weights["dssim"] == 0.2 and weights["outside_opacity"] == 0.3


def loss_before_black(opacity, loss, ignore_moving=None, *, visible=None, step=0, **other):
    """The loss and its terms of a picture that is black but for a corner, where a black Gaussian
    covers the middle."""
    side = 16
    camera = jax.tree.map(lambda x: x[None], toy.camera(0.0, 0.0, side, side))
    truth = np.zeros((1, side**2, 3), np.uint8)
    truth[:, :40] = 200
    batch = Batch(
        jnp.zeros((1, 1), jnp.int32),
        jnp.zeros((1, 1), jnp.int32),
        TIMES,
        jnp.asarray(truth)[None],
        None if visible is None else jnp.asarray(visible)[None, None],
    )
    trace = TraceOptions(bundle=8, k=8)
    other = other or {"backdrop": (0.0, 0.0, 0.0)}
    options = StepOptions(loss, OptimizerOptions(), trace, **other)
    black = toy.gaussians(np.zeros((1, 3)), 0.3, 0.0)
    none = unconstrain(jax.tree.map(lambda x: x[:0], black))
    faded = dataclasses.replace(black, opacity=opacity[None])
    parts = Parameters(unconstrain(faded), none, None)
    seen = camera_set(np.arange(1), camera, extent=EXTENT)
    state = begin_state(Parameters(unconstrain(black), none, None))
    sizes = measure_sizes(state, camera, batch, seen, options=options, mesh=mesh(1))
    one = jax.tree.map(lambda x: x[0], batch)
    value, details = loss_of(
        parts,
        camera,
        one,
        seen,
        state.step + step,
        options=options,
        sizes=sizes,
        ignore_moving=ignore_moving,
    )
    return value, details.terms, truth[0, :, 0] == 0


def test_what_is_black_before_a_black_backdrop_costs_its_opacity():
    loss, opacity = LossOptions(**NO_PLANES, backdrop_opacity=0.1), toy.single(0.6)
    _, terms, empty = loss_before_black(opacity, loss)
    black = toy.gaussians(np.zeros((1, 3)), 0.3, 0.0, opacity=0.6)
    renderer = Renderer(
        Scene(black),
        options=RenderOptions(samples=1),
        trace=TraceOptions(bundle=8, k=8),
    )
    alpha = renderer(toy.camera(0.0, 0.0, 16, 16)).alpha
    places = tile_order(16, 8)
    expected = np.where(empty, np.asarray(alpha).reshape(-1)[places], 0).mean()
    assert expected > 0.03
    np.testing.assert_allclose(terms["backdrop_opacity"], expected, rtol=1e-4)


def test_beside_a_silhouette_opacity_costs_and_colour_does_not():
    loss, opacity = LossOptions(**NO_PLANES, outside_opacity=0.3), toy.single(0.6)
    hidden = {"visible": np.zeros(16**2, bool)}
    _, terms, _ = loss_before_black(opacity, loss, **hidden, silhouettes=True)
    assert terms["l1"] == 0 and terms["outside_opacity"] > 0.03 and len(terms) == 3
    # Masks that are no silhouettes leave open what is behind them.
    value, terms, _ = loss_before_black(opacity, loss, **hidden, silhouettes=False)
    assert value == 0 and "outside_opacity" not in terms


def test_within_a_silhouette_another_colour_is_behind_in_each_step():
    loss, whole = LossOptions(**NO_PLANES, outside_opacity=0.3), {"visible": np.ones(16**2, bool)}

    def costs(opacity):
        opacity = toy.single(opacity)
        found = (
            loss_before_black(opacity, loss, **whole, step=step, silhouettes=True)
            for step in range(4)
        )
        return [float(value) for value, *_ in found]

    faint, solid = np.array(costs(0.1)), np.array(costs(0.95))
    assert len(np.unique(faint)) == 4
    # What is black in the picture costs least if no light passes.
    assert np.all(solid < faint)


def test_nothing_else_makes_black_before_black_fade():
    def slope(weight):
        loss = LossOptions(**NO_PLANES, backdrop_opacity=weight)
        return jax.grad(lambda x: loss_before_black(x, loss)[0])(toy.single(0.6))

    assert abs(slope(0.0)) < CLOSE < 1e-3 < slope(0.1)


def test_late_in_a_stage_of_what_stands_still_pixels_that_differ_much_have_no_say():
    loss = LossOptions(backdrop_opacity=0.0)
    costs = [
        float(loss_before_black(toy.single(0.6), loss, ignored)[0])
        for ignored in (None, jnp.asarray(False), jnp.asarray(True))
    ]
    # Only the border of the bright corner is left, where the mean over 5 x 5 pixels is small.
    assert costs[0] == costs[1] > 0.05 and costs[2] < 0.2 * costs[0]
