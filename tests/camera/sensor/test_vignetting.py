"""How dark the corners are: the cosine law of a flat film, and the polynomial."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from gaussray.camera.film import Film
from gaussray.camera.lens import KannalaBrandt, pinhole
from gaussray.camera.sensor.vignetting import least_transmission, transmission


# Products of a few factors in double precision.
EXACT = 1e-12
GRADIENT = 1e-5
NONE = jnp.zeros(3)

shares = eqx.filter_jit(transmission)


def seen(width, height, focal, center=None, falloff=0.0, polynomial=NONE):
    center = (width / 2, height / 2) if center is None else center
    lens = pinhole(jnp.full(2, float(focal)), jnp.array(center, float))
    film = Film(width, height, "center")
    return np.asarray(shares(lens, film, jnp.array(falloff), jnp.asarray(polynomial)))


def test_a_flat_film_darkens_with_the_fourth_power_of_the_cosine():
    # 90 degrees across: the middle of the rightmost pixel is at 45 degrees less half a pixel.
    share = seen(20, 10, 10.0, falloff=4.0)
    x, y = (9.5, 4.5)
    corner = (100 / (100 + x * x + y * y)) ** 2
    np.testing.assert_allclose(share[[0, 0, -1, -1], [0, -1, 0, -1]], corner, rtol=EXACT)
    assert 0.2 < corner < 0.3
    np.testing.assert_allclose(share[5, 10], (100 / 100.5) ** 2, rtol=EXACT)


def test_the_polynomial_counts_in_half_diagonals_from_the_axis():
    a = (-0.3, 0.2, -0.5)
    share = seen(3, 3, 5.0, polynomial=jnp.array(a))
    np.testing.assert_allclose(share[1, 1], 1)
    square = (1 + 1) / (1.5**2 + 1.5**2)
    expected = 1 + a[0] * square + a[1] * square**2 + a[2] * square**3
    np.testing.assert_allclose(share[[0, 0, 2, 2], [0, 2, 0, 2]], expected, rtol=EXACT)
    # With the axis on a pixel's middle in the corner, the opposite pixel is two pixels off.
    moved = seen(3, 3, 5.0, center=(0.5, 0.5), polynomial=jnp.array([-0.2, 0.0, 0.0]))
    np.testing.assert_allclose(moved[0, 0], 1)
    np.testing.assert_allclose(moved[0, 2], 1 - 0.2 * 4 / 4.5, rtol=EXACT)


def test_light_is_never_taken_away_below_none():
    share = seen(3, 3, 5.0, center=(0.5, 0.5), polynomial=jnp.array([-1.0, 0.0, 0.0]))
    assert share[2, 2] == 0 and share.min() == 0


def test_without_falloff_and_polynomial_all_light_passes():
    np.testing.assert_array_equal(seen(5, 4, 3.0), np.ones((4, 5)))


def test_no_light_from_beside_or_behind_the_lens_unless_falloff_is_zero():
    lens = KannalaBrandt(jnp.array([4.0, 4.0]), jnp.array([8.0, 8.0]), jnp.zeros(4), jnp.array(3.0))
    film = Film(16, 16, "center")
    cos = np.asarray(jax.vmap(lens.direction)(jnp.array([[0.5, 8.0], [8.5, 8.0]]))[:, 2])
    assert cos[0] < 0 < cos[1]
    share = np.asarray(shares(lens, film, jnp.array(4.0), NONE))
    assert share[8, 0] == 0 and share[8, 8] > 0.9
    np.testing.assert_array_equal(shares(lens, film, jnp.array(0.0), NONE), 1)


def test_both_multiply():
    polynomial = jnp.array([-0.3, 0.1, 0.0])
    both = seen(6, 4, 5.0, falloff=3.0, polynomial=polynomial)
    apart = seen(6, 4, 5.0, falloff=3.0) * seen(6, 4, 5.0, polynomial=polynomial)
    np.testing.assert_allclose(both, apart, rtol=EXACT)


def test_gradients():
    film = Film(4, 3, "center")

    def total(*values):
        focal, falloff, polynomial = (jnp.asarray(x) for x in values)
        lens = pinhole(jnp.stack([focal, focal]), jnp.array([2.0, 1.5]))
        return jnp.sum(transmission(lens, film, falloff, polynomial))

    values = (jnp.array(3.0), jnp.array(4.0), jnp.array([-0.2, 0.1, -0.05]))
    check_grads(jax.jit(total), values, 1, ("rev",), GRADIENT, GRADIENT)


def test_the_least_share_is_found_between_axis_and_corner():
    assert least_transmission((-0.5, 0.0, 0.0)) == 0.5 and least_transmission((0.2, 0.0, 0.0)) == 1
    # 1 - 4 s + 4 s^2 = (1 - 2 s)^2 touches 0 in the middle.
    assert least_transmission((-4.0, 4.0, 0.0)) == pytest.approx(0, abs=EXACT)
