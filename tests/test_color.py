"""The sRGB curve: known values, its inverse, gradients everywhere."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gaussray.color import srgb_decode, srgb_encode


def test_known_linear_values_have_the_codes_that_blender_writes():
    codes = 255 * srgb_encode(np.array([0.0, 0.18, 0.5, 1.0]))
    np.testing.assert_array_equal(np.round(codes), [0, 118, 188, 255])


def test_decoding_inverts_encoding_also_outside_the_unit_interval():
    linear = np.linspace(-2, 5, 701)
    # The standard's two pieces miss each other by 3e-8 at the joint.
    np.testing.assert_allclose(srgb_decode(srgb_encode(linear)), linear, atol=1e-7)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_the_array_library_and_the_dtype_stay(kind):
    values = np.array([0.001, 0.5], kind)
    for curve in (srgb_encode, srgb_decode):
        assert isinstance(curve(values), np.ndarray) and curve(values).dtype == kind
        assert isinstance(curve(jnp.asarray(values)), jax.Array)
        assert curve(jnp.asarray(values)).dtype == kind
        np.testing.assert_allclose(curve(jnp.asarray(values)), curve(values), rtol=1e-6)


@pytest.mark.parametrize("value", [-1.0, 0.0, 1e-30])
def test_the_gradient_at_and_below_zero_is_that_of_the_straight_line(value):
    assert jax.grad(srgb_encode)(jnp.asarray(value)) == pytest.approx(12.92)
    assert jax.grad(srgb_decode)(jnp.asarray(value)) == pytest.approx(1 / 12.92)
