"""Colour filters: which pixel sees what, and the colours made from it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gaussray.camera.sensor.mosaic import PATTERNS, demosaic, filter_mask, mosaic


# Means of up to eight numbers in double precision.
EXACT = 1e-12
LIGHT = jnp.asarray(np.random.default_rng(0).uniform(0, 1, (7, 6, 3)))


def brute_force(raw, seen):
    """The mean of the nearest photosites that saw a colour, pixel by pixel."""
    height, width, _ = raw.shape
    out = np.empty(raw.shape)
    for y, x, c in np.ndindex(*raw.shape):
        near = {}
        for i in range(max(y - 1, 0), min(y + 2, height)):
            for j in range(max(x - 1, 0), min(x + 2, width)):
                if seen[i, j, c]:
                    near.setdefault((i - y) ** 2 + (j - x) ** 2, []).append(raw[i, j, c])
        out[y, x, c] = np.mean(near[min(near)])
    return out


@pytest.mark.parametrize("pattern", PATTERNS)
def test_a_pattern_names_the_filters_of_two_rows(pattern):
    seen = filter_mask(pattern, 5, 6)
    np.testing.assert_array_equal(seen.sum(-1), 1)
    letters = np.array(list("RGB"))[seen.argmax(-1)]
    assert "".join(letters[:2, :2].ravel()) == pattern
    np.testing.assert_array_equal(letters[2:4, 2:4], letters[:2, :2])
    raw = mosaic(LIGHT, pattern)
    channel = filter_mask(pattern, 7, 6).argmax(-1)[..., None]
    kept = np.take_along_axis(np.asarray(LIGHT), channel, -1)[..., 0]
    np.testing.assert_array_equal(raw.sum(-1), kept)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_colours_are_means_of_the_nearest_that_saw_them(pattern):
    raw = mosaic(LIGHT, pattern)
    found = jax.jit(demosaic, static_argnums=1)(raw, pattern)
    expected = brute_force(np.asarray(raw), filter_mask(pattern, 7, 6))
    np.testing.assert_allclose(found, expected, atol=EXACT)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_even_light_and_inside_even_slopes_come_back(pattern):
    even = jnp.broadcast_to(jnp.array([0.2, 0.5, 0.9]), (4, 5, 3))
    np.testing.assert_allclose(demosaic(mosaic(even, pattern), pattern), even, atol=EXACT)
    y, x = jnp.mgrid[:6, :8]
    slope = jnp.stack([0.1 * x, 0.2 * y, 0.05 * x + 0.1 * y], -1)
    found = demosaic(mosaic(slope, pattern), pattern)
    np.testing.assert_allclose(found[1:-1, 1:-1], slope[1:-1, 1:-1], atol=EXACT)
