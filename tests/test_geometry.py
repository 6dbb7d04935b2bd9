"""Conventions by known directions, laws of rotations, and limits at zero."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
from jax.test_util import check_grads
from scipy.spatial.transform import Rotation

from gaussray.geometry import (
    BLENDER_AXES,
    RigidTransform,
    best_rotation,
    epipolar_angle,
    even_directions,
    normalize,
    normalize_quaternion,
    quaternion,
    rotation_matrix,
    safe_norm,
    slerp,
    turning,
)


EXACT = 1e-12
# Finite differences of check_grads.
GRADIENT = 1e-6
# What slerp promises where it goes over to its limit.
LINEAR = 1e-5
IDENTITY = jnp.array([1.0, 0, 0, 0])

matrix = jax.jit(rotation_matrix)
back = jax.jit(quaternion)
between = jax.jit(slerp)


def quaternions(count=50, seed=0):
    return jnp.asarray(np.random.default_rng(seed).normal(size=(count, 4)))


def about(axis, angle):
    return jnp.asarray(np.append(np.cos(angle / 2), np.sin(angle / 2) * np.asarray(axis, float)))


def test_a_quarter_turn_about_z_takes_x_to_y():
    turned = matrix(about([0, 0, 1], np.pi / 2)) @ jnp.eye(3)
    np.testing.assert_allclose(turned.T, [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], atol=EXACT)


def test_blender_axes_turn_a_camera_that_looks_down_minus_z_forward():
    turn = np.diag(BLENDER_AXES)
    np.testing.assert_array_equal(turn @ [0, 0, -1], [0, 0, 1])
    np.testing.assert_array_equal(turn @ [0, 1, 0], [0, -1, 0])
    np.testing.assert_array_equal(turn @ turn, np.eye(3))
    assert np.linalg.det(turn) == 1


def test_rotations_are_those_of_the_sandwich_product():
    q = quaternions()
    np.testing.assert_allclose(matrix(q), reference.rotation(q), atol=EXACT)


@pytest.mark.parametrize("length", [1e-300, 1e-160, 3.0, 1e160, 1e300])
def test_length_of_a_quaternion_does_not_matter(length):
    q = quaternions(5)
    np.testing.assert_allclose(matrix(length * q), matrix(q), atol=EXACT)


@pytest.mark.parametrize("length", [1e-30, 1.0, 1e30])
def test_gradient_of_a_rotation_is_inverse_to_the_length(length):
    q = quaternions(1)[0].astype(jnp.float32)
    slope = jax.jit(jax.jacobian(rotation_matrix))
    found = np.asarray(slope(np.float32(length) * q), np.float64) * length
    np.testing.assert_allclose(found, slope(q), atol=1e-5)


def test_the_zero_quaternion_is_the_identity_without_gradient():
    zero = jnp.zeros(4)
    np.testing.assert_array_equal(normalize_quaternion(zero), IDENTITY)
    np.testing.assert_array_equal(matrix(zero), np.eye(3))
    assert not np.any(jax.jit(jax.jacobian(rotation_matrix))(zero))


def test_rotation_gradients_are_the_finite_differences():
    check_grads(matrix, (quaternions(1)[0],), 1, ["rev"], atol=GRADIENT, rtol=GRADIENT)


def test_quaternion_is_the_inverse_of_rotation_matrix():
    turns = [about(axis, angle) for axis in np.eye(3) for angle in (0, 1e-9, np.pi, np.pi - 1e-9)]
    for q in [*quaternions(20), *turns]:
        found = back(matrix(q))
        np.testing.assert_allclose(matrix(found), matrix(q), atol=EXACT)
        assert found[0] >= 0
        np.testing.assert_allclose(safe_norm(found), 1, atol=EXACT)


def test_turning_is_the_rotation_by_the_length_of_the_vector():
    vector = np.random.default_rng(4).normal(size=3)
    angle = np.linalg.norm(vector)
    expected = about(vector / angle, angle)
    np.testing.assert_allclose(turning(jnp.asarray(vector)), expected, atol=1e-12)
    np.testing.assert_array_equal(turning(jnp.zeros(3)), [1, 0, 0, 0])
    slope = jax.jacobian(turning)(jnp.zeros(3))
    np.testing.assert_allclose(slope, np.vstack([np.zeros(3), np.eye(3) / 2]), atol=1e-12)


def test_slerp_turns_at_constant_rate_the_short_way():
    start, end = about([0, 0, 1], 0.3), about([0, 0, 1], 1.5)
    for sign in (1, -1):
        for fraction in (0.0, 0.25, 1.0):
            found = between(start, sign * end, jnp.array(fraction))
            expected = matrix(about([0, 0, 1], 0.3 + 1.2 * fraction))
            np.testing.assert_allclose(matrix(found), expected, atol=EXACT)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.03, 0.06, 0.07])
def test_slerp_of_close_rotations_keeps_its_rate(angle):
    found = between(IDENTITY, about([1, 0, 0], angle), jnp.array(0.3))
    np.testing.assert_allclose(found, about([1, 0, 0], 0.3 * angle), atol=LINEAR)
    slope = jax.jit(jax.jacobian(slerp, argnums=2))(
        IDENTITY, about([1, 0, 0], angle), jnp.array(0.3)
    )
    expected = 0.5 * angle * np.array([-np.sin(0.15 * angle), np.cos(0.15 * angle), 0, 0])
    np.testing.assert_allclose(slope, expected, atol=LINEAR)


def test_normalize_keeps_direction_at_any_length_and_zero_at_zero():
    way = jnp.array([3.0, -4.0, 0.0])
    for length in (1e-300, 1.0, 1e300):
        np.testing.assert_allclose(normalize(length * way), [0.6, -0.8, 0], atol=EXACT)
    np.testing.assert_array_equal(normalize(jnp.zeros(3)), np.zeros(3))
    projector = np.eye(3) - np.outer([0.6, -0.8, 0], [0.6, -0.8, 0])
    np.testing.assert_allclose(jax.jacobian(normalize)(way), projector / 5, atol=EXACT)


def test_safe_norm_has_no_gradient_at_zero():
    assert safe_norm(jnp.zeros(3)) == 0
    np.testing.assert_array_equal(jax.grad(safe_norm)(jnp.zeros(3)), np.zeros(3))
    np.testing.assert_allclose(jax.grad(safe_norm)(jnp.array([3.0, 4])), [0.6, 0.8], atol=EXACT)


def test_the_best_rotation_is_that_between_the_vectors():
    dice = np.random.default_rng(0)
    vectors = dice.normal(size=(5, 20, 3))
    quat = quaternions(5)
    turned = np.einsum("nij,nkj->nki", rotation_matrix(quat), vectors)
    found = best_rotation(jnp.asarray(np.einsum("nki,nkj->nij", vectors, turned)))
    np.testing.assert_allclose(rotation_matrix(found), rotation_matrix(quat), atol=1e-9)
    np.testing.assert_allclose(best_rotation(jnp.zeros((3, 3))), [1, 0, 0, 0], atol=EXACT)


def test_a_rigid_transform_and_its_inverse_cancel():
    world_from_camera = RigidTransform(quaternions(1)[0], jnp.array([1.0, 2, 3]))
    point = jnp.array([0.3, -0.7, 2.0])
    there = world_from_camera.apply(point)
    np.testing.assert_allclose(world_from_camera.inverse_apply(there), point, atol=EXACT)
    np.testing.assert_allclose(there - world_from_camera.rotate(point), [1, 2, 3], atol=EXACT)
    np.testing.assert_allclose(safe_norm(there - world_from_camera.translation), safe_norm(point))


@pytest.mark.parametrize("length", [1e-30, 1e-20, 1.0, 1e20, 1e30])
def test_a_length_whose_square_is_no_single_number_is_right(length):
    vector = jnp.asarray([0.6 * length, 0.0, -0.8 * length], jnp.float32)
    value, slope = jax.value_and_grad(safe_norm)(vector)
    np.testing.assert_allclose(value, length, rtol=1e-6)
    np.testing.assert_allclose(slope, [0.6, 0, -0.8], rtol=1e-6)


def test_directions_are_spread_evenly():
    found = even_directions(300)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, atol=1e-12)
    assert np.abs(found.mean(axis=0)).max() < 1e-3
    gap = np.sort(2 - 2 * found @ found.T, axis=1)[:, 1] ** 0.5
    assert gap.min() > 0.6 * gap.max()


def test_rays_that_meet_lie_in_the_plane_of_both_cameras():
    dice = np.random.default_rng(3)
    eyes, points = dice.normal(size=(2, 3)), dice.normal(size=(20, 3)) + [0, 0, 5]
    one, other = ((points - eye) / np.linalg.norm(points - eye, axis=1)[:, None] for eye in eyes)
    baseline = eyes[1] - eyes[0]
    np.testing.assert_allclose(epipolar_angle(one, other, baseline), 0, atol=1e-9)
    # Turned about the baseline, a ray leaves the plane by the angle between both planes, seen from
    # the ray: sin = sin(turn) sin(angle to the baseline).
    turn, along = 0.01, baseline / np.linalg.norm(baseline)
    turned = Rotation.from_rotvec(turn * along).apply(other)
    sine = np.sin(turn) * np.linalg.norm(np.cross(other, along), axis=1)
    np.testing.assert_allclose(epipolar_angle(one, turned, baseline), np.arcsin(sine), rtol=1e-6)
    assert epipolar_angle(baseline[None], other[:1], baseline).tolist() == [0]
