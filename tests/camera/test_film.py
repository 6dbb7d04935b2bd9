"""The film: filters as Blender has them, and the pixel grid."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gaussray.camera.film import Film, pixel_grid, sample_offset


COUNT = 20001
# Both tables (ours and Cycles') have 1024 cells, and straight tails within the outermost ones.
TABLE = 3e-3


def film(filter="box", filter_width=1.0):
    return Film(4, 3, filter, filter_width)


def offsets(film):
    u = (jnp.arange(COUNT) + 0.5) / COUNT
    both = jax.jit(jax.vmap(lambda u: sample_offset(film, u)))(jnp.stack([u, 1 - u], -1))
    np.testing.assert_allclose(both[:, 0], both[::-1, 1], atol=1e-12)  # both axes alike
    return np.array(both[:, 0])


@pytest.mark.parametrize(
    "filter, width, deviation",
    [
        ("box", 1.0, 1 / np.sqrt(12)),
        ("box", 2.0, 2 / np.sqrt(12)),
        ("blackman_harris", 3.0, 0.4163),  # measured in Cycles 4.5.15, filter_width 1.5
        ("blackman_harris", 6.0, 0.8327),  # measured, filter_width 3
        ("gaussian", 4.5, 0.3801),  # measured, filter_width 1.5
        ("center", 1.0, 0.0),
    ],
)
def test_standard_deviation_is_the_filters(filter, width, deviation):
    offset = offsets(film(filter, width))
    np.testing.assert_allclose(offset.std(), deviation, atol=TABLE)
    np.testing.assert_allclose(offset.mean(), 0, atol=1e-12)


@pytest.mark.parametrize(
    "filter, width, measured",
    [
        ("blackman_harris", 3.0, (1.0, 0.9937, 0.4993, 0.0062, 0.0)),
        ("blackman_harris", 6.0, (0.9937, 0.8811, 0.4992, 0.1184, 0.0062)),
        ("gaussian", 4.5, (0.9997, 0.9958, 0.4992, 0.0038, 0.0002)),
        ("box", 1.0, (1.0, 1.0, 0.4995, 0.0, 0.0)),
    ],
)
def test_an_edge_through_a_pixels_middle_is_as_soft_as_in_blender(filter, width, measured):
    """Five pixels across an edge, measured in Cycles 4.5.15 with 1024 samples a pixel."""
    share = [np.mean(offsets(film(filter, width)) < -pixel) for pixel in (-2, -1, 0, 1, 2)]
    np.testing.assert_allclose(share, measured, atol=TABLE)


@pytest.mark.parametrize("filter", ["gaussian", "blackman_harris"])
def test_samples_follow_the_filter_everywhere(filter):
    """The share of samples below x is the filter's integral up to x."""
    offset = offsets(film(filter, 3.0))
    x = np.linspace(-1.5, 1.5, 3001)
    v = 2 * np.pi * (x / 3 + 0.5)
    weight = {
        "gaussian": np.exp(-2 * (6 * x / 3) ** 2),
        "blackman_harris": 0.35875
        - 0.48829 * np.cos(v)
        + 0.14128 * np.cos(2 * v)
        - 0.01168 * np.cos(3 * v),
    }[filter]
    share = np.cumsum(weight) / weight.sum()
    ours = np.searchsorted(np.sort(offset), x) / COUNT
    np.testing.assert_allclose(ours, share, atol=TABLE)


@pytest.mark.parametrize("filter", ["box", "gaussian", "blackman_harris", "center"])
def test_the_middle_is_zero_and_the_ends_are_the_width(filter):
    filtered = film(filter, 3.0)
    assert (sample_offset(filtered, jnp.array([0.5, 0.5])) == 0).all()
    width = 0 if filter == "center" else 1.5
    for u, end in ((0.0, -width), (1.0, width)):
        np.testing.assert_allclose(sample_offset(filtered, jnp.array([u, u])), end, rtol=1e-12)


@pytest.mark.parametrize("filter", ["box", "gaussian", "blackman_harris", "center"])
def test_offsets_grow_with_u_and_single_precision_stays_single(filter):
    assert (np.diff(offsets(film(filter, 3.0))) >= 0).all()
    offset = sample_offset(film(filter, 3.0), jnp.array([0.3, 1 - 1e-7], jnp.float32))
    assert offset.dtype == jnp.float32 and np.isfinite(offset).all()


def test_the_pixel_grid_is_column_then_row():
    grid = pixel_grid(film())
    assert grid.shape == (3, 4, 2)
    np.testing.assert_array_equal(grid[2, 1], [1, 2])


def test_a_film_has_no_leaves_and_compares_by_value():
    assert not jax.tree.leaves(film())
    assert film() == film() and hash(film()) == hash(film())


@pytest.mark.parametrize(
    "build, message",
    [
        (lambda: Film(0, 3), "film.width must be a whole number from 1, got 0"),
        (lambda: Film(3, -1), "film.height must be a whole number from 1, got -1"),
        (lambda: Film(3, 3, "tent"), "film.filter must be one of"),
        (lambda: Film(3, 3, "box", 0.0), "film.filter_width must be above 0, got 0.0"),
    ],
)
def test_what_is_no_film_is_refused_by_name(build, message):
    with pytest.raises(ValueError, match=message):
        build()
