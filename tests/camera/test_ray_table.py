"""A table of directions: as exact as its spacing allows, and refused where it is no lens."""

import functools
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from lenses import zoo

from gaussray.camera.lens import check_lens, ray_table


WIDTH, HEIGHT = 96, 64
look = jax.jit(jax.vmap(jax.vmap(lambda lens, pixel: lens.direction(pixel), (None, 0)), (None, 0)))


def cells(rows, columns, width=WIDTH, height=HEIGHT):
    """Pixels in the middle of equal cells of the picture."""
    column, row = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    return jnp.asarray(np.stack([column * width / columns, row * height / rows], -1))


@functools.cache
def lens():
    return zoo(WIDTH, HEIGHT)["thin_prism_fisheye"]


def sampled(rows, columns):
    return np.asarray(look(lens(), cells(rows, columns)))


def test_at_its_samples_it_is_the_table_itself():
    rays = sampled(16, 24)
    again = np.asarray(look(ray_table(jnp.asarray(rays), WIDTH, HEIGHT), cells(16, 24)))
    lit = np.any(again != 0, axis=-1)
    assert lit.mean() > 0.4
    np.testing.assert_allclose(again[lit], rays[lit], atol=1e-12)


def test_a_direction_for_every_pixel_is_one_for_every_pixels_centre():
    table = ray_table(jnp.asarray(sampled(HEIGHT, WIDTH)), WIDTH, HEIGHT)
    np.testing.assert_array_equal(table.focal, [1, 1])
    np.testing.assert_array_equal(table.center, [0.5, 0.5])


def test_half_the_spacing_leaves_an_eighth_of_the_error():
    """Catmull and Rom's interpolation is of third order; the outermost cells' is of fourth."""
    pixels = cells(47, 71)
    truth, errors = np.asarray(look(lens(), pixels)), []
    for rows, columns in ((16, 24), (32, 48)):
        found = np.asarray(
            look(ray_table(jnp.asarray(sampled(rows, columns)), WIDTH, HEIGHT), pixels)
        )
        lit = np.any(found != 0, axis=-1) & np.any(truth != 0, axis=-1)
        errors.append(np.abs(found - truth)[lit].max())
    assert errors[1] < 2e-4
    assert errors[0] / errors[1] > 6


def test_black_samples_are_black_with_their_neighbours():
    rays = sampled(16, 24)
    dark = rays.copy()
    dark[8, 12] = 0
    full, holed = (ray_table(jnp.asarray(x), WIDTH, HEIGHT) for x in (rays, dark))
    before, after = (np.any(look(lens, cells(64, 96)) != 0, axis=-1) for lens in (full, holed))
    # Two cells of four pixels to every side.
    assert (before & ~after).sum() == 16**2 and not (after & ~before).any()
    assert (before & ~after)[26:42, 42:58].all()


def refused(rays):
    return ray_table(jnp.asarray(rays), WIDTH, HEIGHT)


def test_what_is_no_lens_is_refused_with_its_place():
    rays = sampled(16, 24)
    folded = rays.copy()
    folded[7, 10], folded[7, 11] = rays[7, 11], rays[7, 10]
    cases = [
        (folded, "lens.file must be invertible: .* fails at row [67], column (9|10|11)"),
        (rays[:, ::-1], "lens.file must be invertible"),
        (rays * (1, -1, 1), "lens.file must be invertible"),
        (1.1 * rays, r"lens.file \(lengths\) must be unit vectors, or zero .*got \[1.1"),
        (0 * rays, "lens.file must hold directions that are not zero"),
        (rays[:3], "lens.file must hold 4 to 513 rows of directions, got 3. Keep every n-th"),
    ]
    for wrong, message in cases:
        with pytest.raises(ValueError, match=message):
            refused(wrong)


def test_a_table_that_sees_a_direction_twice_is_refused():
    """Each cell turns as it should, but the picture goes around the axis more than once."""
    column, row = np.meshgrid(np.linspace(-1.3, 1.3, 24) * np.pi, np.linspace(-1, 1, 16))
    rays = np.stack([np.sin(column) * np.cos(row), np.sin(row), np.cos(column) * np.cos(row)], -1)
    table = refused(rays)
    with pytest.raises(ValueError, match=re.escape("lens.file must give every pixel a direction")):
        check_lens(table, WIDTH, HEIGHT)
