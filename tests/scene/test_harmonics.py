"""The harmonics are those of the definition, in the order and sign of 3DGS."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference

from gaussray.scene.harmonics import C0, constant_harmonics, harmonic_basis, radiance


EXACT = 1e-12


def directions(count=50, seed=0):
    way = np.random.default_rng(seed).normal(size=(count, 3))
    way = np.concatenate([way, np.eye(3), -np.eye(3)])
    return way / np.linalg.norm(way, axis=-1, keepdims=True)


@pytest.mark.parametrize("degree", range(4))
def test_basis_is_that_of_legendre_polynomials(degree):
    way = directions()
    found = np.stack(harmonic_basis(jnp.asarray(way.T), (degree + 1) ** 2), axis=-1)
    expected = [
        reference.harmonic(level, order, way)
        for level in range(degree + 1)
        for order in range(-level, level + 1)
    ]
    np.testing.assert_allclose(found, np.stack(expected, axis=-1), atol=EXACT)


def test_basis_is_orthonormal_over_the_sphere():
    # Gauss-Legendre in z and equal steps in azimuth integrate polynomials of degree 6 exactly.
    z, weight = np.polynomial.legendre.leggauss(8)
    azimuth = 2 * np.pi * np.arange(16) / 16
    r = np.sqrt(1 - z**2)[:, None]
    way = np.stack([r * np.cos(azimuth), r * np.sin(azimuth), np.broadcast_to(z[:, None], (8, 16))])
    values = np.stack(harmonic_basis(jnp.asarray(way), 16))
    product = np.einsum("aij,bij,i->ab", values, values, weight) * 2 * np.pi / 16
    np.testing.assert_allclose(product, np.eye(16), atol=EXACT)


def test_radiance_is_clamped_at_black_and_starts_at_a_half():
    way = jnp.asarray(directions(4).T)
    harmonics = jnp.zeros((4, 3)).at[0].set(jnp.array([0.0, -10, 1]))
    seen = radiance(jnp.broadcast_to(harmonics[..., None], (4, 3, way.shape[1])), way)
    expected = np.array([0.5, 0, 0.5 + C0])[:, None]
    np.testing.assert_allclose(seen, np.broadcast_to(expected, seen.shape), atol=EXACT)


@pytest.mark.parametrize("degree", range(4))
def test_constant_colour_is_the_same_from_everywhere(degree):
    color = jnp.array([0.1, 0.5, 2.0])
    way = jnp.asarray(directions(5).T)
    harmonics = constant_harmonics(color, degree)
    assert harmonics.shape == ((degree + 1) ** 2, 3)
    seen = jax.jit(radiance)(jnp.broadcast_to(harmonics[..., None], (*harmonics.shape, 11)), way)
    expected = np.broadcast_to(np.asarray(color)[:, None], (3, 11))
    np.testing.assert_allclose(seen, expected, atol=EXACT)
