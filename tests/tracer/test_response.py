"""One ray and one Gaussian, by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from gaussray.scene.gaussians import whitening_matrix
from gaussray.tracer.response import opacity_on_ray, reach_radius, response


EXACT = 1e-12
# Finite differences of check_grads.
GRADIENT = 1e-6


@jax.jit
def meet(mean, quat, scale, origin, direction):
    frame = whitening_matrix(quat, scale).reshape(9)
    return response(list(frame), list(mean), origin, direction)


X, Y, Z = (jnp.asarray(row) for row in np.eye(3))
STILL = jnp.array([1.0, 0, 0, 0])


def test_a_ray_past_a_sphere_peaks_beside_its_centre():
    t, q = meet(jnp.array([0.0, 0, 5]), STILL, jnp.full(3, 0.5), 0.75 * X, Z)
    np.testing.assert_allclose([t, q], [5.0, 1.5**2], atol=EXACT)


def test_along_a_slanted_gaussian_the_peak_is_not_the_nearest_point():
    # Axes (1, 1/2) turned by 45 degrees about y: a ray along z through x = 1/2.
    quat = jnp.array([np.cos(np.pi / 8), 0, np.sin(np.pi / 8), 0])
    t, q = meet(3 * Z, quat, jnp.array([1.0, 1, 0.5]), 0.5 * X, Z)
    c = np.cos(np.pi / 4)
    inverse = np.linalg.inv(
        np.array([[c, c], [-c, c]]) @ np.diag([1.0, 0.25]) @ np.array([[c, -c], [c, c]])
    )
    # Minimum over z of (1/2, z) inverse (1/2, z).
    z = -inverse[0, 1] * 0.5 / inverse[1, 1]
    least = np.array([0.5, z]) @ inverse @ np.array([0.5, z])
    np.testing.assert_allclose([t, q], [3 + z, least], atol=EXACT)


def test_behind_the_origin_the_distance_is_negative():
    t, _ = meet(-2 * Z, STILL, jnp.ones(3), jnp.zeros(3), Z)
    np.testing.assert_allclose(t, -2, atol=EXACT)


def test_length_of_the_direction_scales_the_distance_alone():
    short = meet(jnp.array([0.3, 0, 5]), STILL, jnp.ones(3), jnp.zeros(3), Z)
    long = meet(jnp.array([0.3, 0, 5]), STILL, jnp.ones(3), jnp.zeros(3), 2 * Z)
    np.testing.assert_allclose([2 * long[0], long[1]], short, atol=EXACT)


def test_without_direction_or_extent_there_is_no_hit():
    _, q = meet(Z, STILL, jnp.ones(3), jnp.zeros(3), jnp.zeros(3))
    assert np.isposinf(q)
    _, q = response([jnp.zeros(())] * 9, list(Z), jnp.zeros(3), Z)
    assert np.isposinf(q)


def test_gradients_are_the_finite_differences():
    given = (
        jnp.array([0.3, -0.2, 4.0]),
        jnp.array([0.9, 0.3, -0.2, 0.5]),
        jnp.array([0.5, 1.5, 0.8]),
        jnp.array([0.1, 0.2, -0.3]),
        jnp.array([0.1, -0.1, 0.9]),
    )
    check_grads(meet, given, order=1, modes=["rev"], rtol=GRADIENT, atol=GRADIENT)


@pytest.mark.parametrize("opacity", [0.004, 0.1, 1.0])
def test_at_its_reach_alpha_is_at_the_cut_off(opacity):
    radius = reach_radius(jnp.array(opacity), 1 / 255)
    alpha = opacity_on_ray(jnp.array(opacity), radius**2, alpha_max=0.99)
    np.testing.assert_allclose(alpha, 1 / 255, atol=EXACT)


def test_what_never_rises_above_the_cut_off_has_no_reach_and_no_gradient():
    for opacity in (0.0, 1e-3, 1 / 255):
        value, slope = jax.value_and_grad(reach_radius)(jnp.array(opacity), 1 / 255)
        assert value == 0 and slope == 0


def test_alpha_is_clamped():
    assert opacity_on_ray(jnp.array(1.0), jnp.array(0.0), alpha_max=0.99) == 0.99
    assert opacity_on_ray(jnp.array(1.0), jnp.array(jnp.inf), alpha_max=0.99) == 0


# Of float32 numbers taken as they are: a few roundings.
SINGLE = 1e-5


@jax.jit
def pulled(*meeting):
    """Gradients of t and q to all inputs, in units of their own sizes."""
    slopes = jax.jacrev(lambda inputs: jnp.stack(meet(*inputs)))(meeting)
    return [slope * jnp.max(jnp.abs(x)) for slope, x in zip(slopes, meeting, strict=True)]


def rounded(*meeting):
    """The same numbers in single and in double precision."""
    single = [jnp.asarray(x, jnp.float32) for x in meeting]
    return single, [x.astype(jnp.float64) for x in single]


def assert_gradients_near(meeting, tolerance):
    single, double = (pulled(*x) for x in rounded(*meeting))
    for row in (0, 1):
        found, truth = (np.concatenate([x[row] for x in part]) for part in (single, double))
        assert np.max(np.abs(found - truth)) < tolerance * np.max(np.abs(truth))


@pytest.mark.parametrize("unit", [1e-11, 1.0, 1e11])
def test_gradients_know_no_unit_of_length(unit):
    mean, scale = unit * jnp.array([0.3, -0.2, 4.0]), unit * jnp.array([0.5, 1.0, 0.7])
    turn = jnp.array([0.8, 0.1, -0.3, 0.5])
    assert_gradients_near((mean, turn, scale, unit * 0.1 * X, Z), SINGLE)


def test_the_reach_keeps_its_digits_just_above_the_cut():
    least = np.float32(1 / 255)
    opacity = least * (1 + np.float32([1e-6, 1e-4, 1e-2, 1]))
    truth = np.sqrt(2 * np.log(opacity.astype(float) / float(least)))
    np.testing.assert_allclose(reach_radius(jnp.asarray(opacity), float(least)), truth, rtol=1e-6)
