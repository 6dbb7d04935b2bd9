"""Electrons follow Poisson's law and reading them Gauss's; every picture has noise of its own."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gaussray.camera.sensor.noise import add_noise, picture_key


COUNT = 40_000
WELL = 4000.0
# Deviations of an estimate: a fair one is further out once in 1.7 million draws.
SIGMAS = 5


count = jax.jit(add_noise)


def electrons(mean, read_noise=0.0, name="a", seed=0, dtype=jnp.float64):
    light = jnp.full(COUNT, mean / WELL, dtype)
    counted = count(picture_key(seed, name), light, dtype(WELL), dtype(read_noise))
    assert counted.dtype == dtype
    return np.asarray(counted, np.float64) * WELL


def near(estimate, expected, variance):
    """Whether the mean of COUNT draws of this variance may be so far from what is expected."""
    return abs(estimate - expected) < SIGMAS * np.sqrt(variance / COUNT)


@pytest.mark.parametrize("mean", [0.0, 0.3, 4.0, 60.0, 3000.0, 50_000.0])
@pytest.mark.parametrize("read_noise", [0.0, 2.5])
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_mean_and_variance_are_those_of_light_and_reading(mean, read_noise, dtype):
    found, read = electrons(mean, read_noise, dtype=dtype), read_noise**2
    variance = mean + read
    if variance == 0:
        np.testing.assert_array_equal(found, 0)
        return
    # The fourth central moment of a sum of Poisson and Gauss says how a variance scatters.
    fourth = mean + 3 * mean**2 + 6 * mean * read + 3 * read**2
    assert near(found.mean(), mean, variance)
    assert near(np.mean((found - mean) ** 2), variance, fourth - variance**2)


def test_light_comes_in_whole_electrons_as_often_as_poisson_says():
    found = np.round(electrons(1.5))
    np.testing.assert_allclose(electrons(1.5), found, atol=1e-9)
    for k, factorial in enumerate((1, 1, 2, 6, 24)):
        share = np.exp(-1.5) * 1.5**k / factorial
        assert near(np.mean(found == k), share, share * (1 - share))


def test_reading_alone_is_gaussian():
    found = electrons(0.0, 3.0) / 3
    for bound, share in ((1, 0.682689), (2, 0.954500), (3, 0.997300)):
        assert near(np.mean(np.abs(found) < bound), share, share * (1 - share))


def test_exposures_add():
    """Two exposures counted apart are one of both: the same mean, variance and share of zeros."""
    apart = electrons(0.4, name="a") + electrons(0.8, name="b")
    for found in (apart, electrons(1.2, name="c")):
        assert near(found.mean(), 1.2, 1.2)
        assert near(np.mean((found - 1.2) ** 2), 1.2, 1.2 + 2 * 1.2**2)
        none = np.exp(-1.2)
        assert near(np.mean(np.round(found) == 0), none, none * (1 - none))


def test_photosites_and_pictures_are_independent():
    light = jnp.full((100, 100, 3), 0.01)
    one, other = (add_noise(picture_key(0, n), light, WELL, 2.0) - light for n in ("a", "b"))
    pairs = ((one[1:], one[:-1]), (one[:, 1:], one[:, :-1]), (one[..., 1:], one[..., :-1]))
    for a, b in (*pairs, (one, other)):
        correlation = np.corrcoef(np.ravel(a), np.ravel(b))[0, 1]
        assert abs(correlation) < SIGMAS / np.sqrt(a.size)


def test_the_noise_of_a_picture_is_that_of_its_seed_and_name():
    same = electrons(50.0, 1.0, "images/pinhole/cam/0003", 7)
    np.testing.assert_array_equal(electrons(50.0, 1.0, "images/pinhole/cam/0003", 7), same)
    for name, seed in (("images/pinhole/cam/0004", 7), ("images/pinhole/cam/0003", 8)):
        assert np.mean(electrons(50.0, 1.0, name, seed) == same) < 0.01


def test_darker_than_black_is_black():
    light = jnp.array([-0.5, 0.0])
    np.testing.assert_array_equal(add_noise(picture_key(0, "a"), light, WELL, 0.0), 0)


def test_the_gradient_is_that_of_the_mean():
    light = jnp.array([0.001, 0.3, 0.9])
    for read_noise in (0.0, 3.0):
        slope = jax.grad(
            lambda x, r=read_noise: jnp.sum(add_noise(picture_key(0, "a"), x, WELL, r))
        )
        np.testing.assert_allclose(slope(light), 1, rtol=1e-12)
