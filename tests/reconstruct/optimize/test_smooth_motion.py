"""The gradient of control points is spread over time, by hand and in its laws."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import toy

from gaussray.reconstruct.optimize.optimizer import Parameters
from gaussray.reconstruct.optimize.smooth_motion import spread_over_time, time_kernel
from gaussray.scene.gaussians import unconstrain


INSTANTS = 40

spread = jax.jit(spread_over_time)


def gradient(control):
    scene = toy.scene()
    free = unconstrain(scene.static), unconstrain(scene.moving)
    return Parameters(*free, toy.deformation(control=control), None)


def test_the_kernel_is_the_sum_of_the_definition():
    kernel = np.asarray(time_kernel(INSTANTS))
    for i, j in ((0, 0), (3, 5), (39, 2)):
        widths = (1, 2, 4, 8, 16)
        want = (i == j) + sum(np.exp(-0.5 * ((i - j) / w) ** 2) / np.sqrt(w) for w in widths)
        assert abs(kernel[i, j] - want) < 1e-6


def test_the_kernel_is_symmetric_and_positive_so_that_a_step_still_descends():
    kernel = np.asarray(time_kernel(INSTANTS), float)
    np.testing.assert_array_equal(kernel, kernel.T)
    assert np.linalg.eigvalsh(kernel).min() > 0.99


def test_what_one_picture_tells_counts_less_the_further_away():
    control = toy.control_points(INSTANTS)
    path = jnp.zeros_like(control.path).at[1, 10, 0].set(2.0)
    turn = jnp.zeros_like(control.turn)
    seen = gradient(eqx.tree_at(lambda c: (c.path, c.turn), control, (path, turn)))
    found = spread(seen).deformation.control
    np.testing.assert_allclose(found.path[1, :, 0], 2 * time_kernel(INSTANTS)[10], rtol=1e-6)
    assert np.all(np.diff(np.asarray(found.path[1, 10:, 0])) < 0)
    assert not np.asarray(found.path)[[0, 2]].any() and not np.asarray(found.turn).any()


def test_everything_else_stays_and_a_scene_without_control_points_too():
    seen = gradient(toy.control_points())
    kept = eqx.tree_at(
        lambda g: (g.deformation.control.path, g.deformation.control.turn),
        spread(seen),
        (seen.deformation.control.path, seen.deformation.control.turn),
    )
    assert eqx.tree_equal(kept, seen)
    without = gradient(None)
    assert eqx.tree_equal(spread(without), without)
