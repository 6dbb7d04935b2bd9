"""Codes that change with the direction become light that changes with the direction."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference

from gaussray.color import srgb_decode
from gaussray.scene import srgb_harmonics as codes


# Sums of 72 float64 terms.
CLOSE = 1e-12
# 72 directions instead of 3200: the curve and the clamp at black are no polynomials.
NET = 0.03

decoded = jax.jit(codes.decode_harmonics)


def harmonics(coefficients, count=5, spread=0.3, seed=0):
    draw = np.random.default_rng(seed)
    return jnp.asarray(spread * draw.normal(size=(count, coefficients, 3)))


def test_the_directions_sum_products_of_harmonics_exactly():
    way, share = codes.sphere_directions()
    np.testing.assert_allclose(np.linalg.norm(way, axis=1), 1, rtol=CLOSE)
    pairs = [(degree, m) for degree in range(4) for m in range(-degree, degree + 1)]
    values = np.stack([reference.harmonic(*pair, way) for pair in pairs], axis=-1)
    ours, sums = codes.harmonic_projection(16)
    np.testing.assert_allclose(ours, values, atol=CLOSE)
    np.testing.assert_allclose(sums.T @ values, np.eye(16), atol=CLOSE)
    np.testing.assert_allclose(share.sum(), 1, rtol=CLOSE)


@pytest.mark.parametrize("coefficients", [1, 4, 16])
def test_a_colour_that_is_the_same_from_everywhere_is_exact_also_below_black(coefficients):
    given = harmonics(coefficients, spread=3.0).at[:, 1:].set(0)
    way = codes.sphere_directions()[0][:3]
    expected = srgb_decode(reference.light(np.asarray(given), way))
    assert (expected == 0).any() and (expected > 1).any()
    np.testing.assert_allclose(
        reference.light(np.asarray(decoded(given)), way), expected, atol=CLOSE
    )


def test_the_coefficients_are_those_of_the_decoded_colour():
    """By another sum over the sphere: a fine net of many directions."""
    given = harmonics(16)
    z, share = np.polynomial.legendre.leggauss(40)
    angle = np.linspace(0, 2 * np.pi, 80, endpoint=False)
    across = np.sqrt(1 - z**2)[:, None]
    way = np.stack(
        np.broadcast_arrays(across * np.cos(angle), across * np.sin(angle), z[:, None]), axis=-1
    ).reshape(-1, 3)
    light = srgb_decode(reference.light(np.asarray(given), way)) - 0.5
    pairs = [(degree, m) for degree in range(4) for m in range(-degree, degree + 1)]
    values = np.stack([reference.harmonic(*pair, way) for pair in pairs], axis=-1)
    weight = np.repeat(share, 80) * 2 * np.pi / 80
    expected = np.einsum("r,rc,rnk->nck", weight, values, light)
    np.testing.assert_allclose(decoded(given), expected, atol=NET)
    assert np.abs(expected - np.asarray(given)).max() > 0.2


@pytest.mark.parametrize("block", [1, 2, 3, 5, 8])
def test_blocks_do_not_matter(monkeypatch, block):
    given = harmonics(4)
    whole = codes.decode_harmonics(given)
    monkeypatch.setattr(codes, "BLOCK", block)
    np.testing.assert_allclose(codes.decode_harmonics(given), whole, atol=CLOSE)


def test_precision_follows_the_data():
    assert decoded(harmonics(4).astype(jnp.float32)).dtype == jnp.float32
