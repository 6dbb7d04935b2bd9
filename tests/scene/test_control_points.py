"""Control points: weights, blended motion, and what deforms with them."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy
from jax.test_util import check_grads
from scipy.special import softmax

from gaussray.geometry import rotation_matrix
from gaussray.scene.bodies import extrapolate_bodies
from gaussray.scene.control_points import (
    ControlPoints,
    control_motion,
    skinning_weights,
    with_fixed_weights,
)
from gaussray.scene.scene import at


# Rounding of float64 sums of a few terms; of float32 sums over lengths of about 1.
EXACT, SINGLE = 1e-12, 2e-6
TIMES = jnp.asarray([0.0, 0.5, 1.0])


def points(seed=0, count=7):
    dice = np.random.default_rng(seed)
    turn = dice.normal(size=(count, 3, 4)) * 0.2
    turn[..., 0] += 1
    return ControlPoints(
        jnp.asarray(dice.normal(size=(count, 3))),
        jnp.asarray(dice.uniform(0.3, 1.0, count)),
        TIMES,
        jnp.asarray(dice.normal(size=(count, 3, 3))),
        jnp.asarray(turn),
    )


def places(count=20, seed=1):
    return jnp.asarray(np.random.default_rng(seed).normal(size=(count, 3)))


def test_one_point_moves_all_as_a_rigid_body():
    one = points(count=1)
    x = places()
    shift, turn = control_motion(one, x, TIMES[1])
    q = one.turn[0, 1] / jnp.linalg.norm(one.turn[0, 1])
    arm = (x - one.pivot) @ rotation_matrix(q).T
    expected = one.path[:, 1] + arm + one.pivot
    np.testing.assert_allclose(x + shift, expected, atol=EXACT)
    np.testing.assert_allclose(turn, np.tile(q, (len(x), 1)), atol=EXACT)


@pytest.mark.parametrize("index", [0, 2])
def test_weights_and_motion_are_those_of_loops(index):
    control, x = points(), places()
    shift, turn = control_motion(control, x, TIMES[index])
    weights = skinning_weights(control, x)
    for i, place in enumerate(np.asarray(x)):
        d = np.linalg.norm(place - np.asarray(control.pivot), axis=1)
        w = np.exp(-0.5 * (d / np.asarray(control.radius)) ** 2)
        w /= w.sum()
        moved, quat = np.zeros(3), np.zeros(4)
        for k, share in enumerate(w):
            q = np.asarray(control.turn[k, index])
            q = q / np.linalg.norm(q)
            c = np.asarray(control.pivot[k])
            arm = np.asarray(rotation_matrix(jnp.asarray(q))) @ (place - c)
            moved += share * (c + np.asarray(control.path[k, index]) + arm)
            quat += share * q
        np.testing.assert_allclose(weights[i], w, atol=EXACT)
        np.testing.assert_allclose(place + shift[i], moved, atol=EXACT)
        np.testing.assert_allclose(turn[i], quat / np.linalg.norm(quat), atol=EXACT)


def test_what_all_points_do_all_gaussians_do():
    control = points()
    q = control.turn[0, 1] / jnp.linalg.norm(control.turn[0, 1])
    turned = control.pivot @ rotation_matrix(q).T + jnp.asarray([[1.0, 2, 3]])
    path = control.path.at[:, 1].set(turned - control.pivot)
    rigid = dataclasses.replace(control, path=path, turn=control.turn.at[:, 1].set(q))
    x = places()
    shift, turn = control_motion(rigid, x, TIMES[1])
    expected = x @ rotation_matrix(q).T + jnp.asarray([[1.0, 2, 3]])
    np.testing.assert_allclose(x + shift, expected, atol=10 * EXACT)
    np.testing.assert_allclose(turn, np.tile(q, (len(x), 1)), atol=EXACT)


def test_far_from_all_points_the_nearest_decides():
    control = dataclasses.replace(points(), radius=jnp.full(7, 0.1))
    x = control.pivot[3:4] + jnp.asarray([[0.0, 0, 60]])
    square = np.sum((np.asarray(x) - np.asarray(control.pivot)) ** 2, axis=1)
    weights = skinning_weights(control, x)[0]
    # Exponents of 180,000, which no float holds: those of the nearest are 0.
    np.testing.assert_allclose(weights, softmax(-square / (2 * 0.1**2)), atol=1e-9)
    assert weights[np.argmin(square)] > 0.99


def test_single_precision_holds_far_from_the_origin():
    control, x = points(), places()
    away = jnp.asarray([[1000.0, -2000, 500]])
    far = dataclasses.replace(control, pivot=control.pivot + away)
    far, there = jax.tree.map(lambda v: v.astype(jnp.float32), (far, x + away))
    # Places of the order of 1000 are known to 1e-4.
    shift, turn = control_motion(far, there, jnp.asarray(0.5, jnp.float32))
    expected, rotation = control_motion(control, x, TIMES[1])
    np.testing.assert_allclose(shift, expected, atol=2e-3)
    np.testing.assert_allclose(turn, rotation, atol=1e-3)


def test_gradients_agree_with_differences():
    control, x = points(count=3), places(4)

    def f(path, turn, pivot, radius, x):
        changed = tuple(jnp.asarray(v) for v in (path, turn, pivot, radius))
        moved = eqx.tree_at(lambda c: (c.path, c.turn, c.pivot, c.radius), control, changed)
        return control_motion(moved, jnp.asarray(x), jnp.asarray(0.3))

    check_grads(
        f, (control.path, control.turn, control.pivot, control.radius, x), order=1, modes=["rev"]
    )


def test_fixed_weights_get_no_gradient_and_poses_do():
    control, x = points(count=3), places(4)

    def shift(control):
        return jnp.sum(control_motion(with_fixed_weights(control), x, TIMES[1])[0])

    slope = jax.grad(shift)(control)
    assert not np.any(slope.pivot) and not np.any(slope.radius) and np.any(slope.path)


def test_points_that_reach_further_keep_their_weights():
    control = points()
    further = extrapolate_bodies(control, 0.1, 0.1)
    assert isinstance(further, ControlPoints) and further.path.shape == (7, 5, 3)
    x = places()
    np.testing.assert_allclose(
        skinning_weights(further, x), skinning_weights(control, x), atol=EXACT
    )


def test_a_scene_moves_with_its_control_points():
    scene = toy.scene(speed=0.0)
    control = toy.control_points()
    scene = dataclasses.replace(scene, deformation=toy.deformation(control=control))
    assert scene.deformation.instants is control.time
    first, last = (at(scene, toy.single(t)).mean[scene.static.count :] for t in (0.0, 1.0))
    shift, _ = control_motion(control, scene.moving.mean, toy.single(1.0))
    np.testing.assert_allclose(last, scene.moving.mean + shift, atol=SINGLE)
    np.testing.assert_allclose(first, scene.moving.mean, atol=SINGLE)
