"""Pictures are cut into tiles and joined again, and every pixel knows its tile."""

import numpy as np
import pytest

from gaussray.camera.film import Film
from gaussray.capture.errors import CaptureError
from gaussray.reconstruct.data.tiles import (
    cut,
    fitting_side,
    join,
    places_in_tiles,
    tile_grid,
    tile_of,
    tile_order,
    tile_pixels,
    tile_places,
)


# Odd sides that tiles of SIDE do not divide: 2 x 3 tiles.
FILM, SIDE = Film(13, 19, "center"), 8


@pytest.fixture
def picture():
    """Values that name their own pixel."""
    return np.arange(FILM.height * FILM.width).reshape(FILM.height, FILM.width)


def test_tiles_hold_every_pixel_and_overlap_at_the_far_borders():
    assert tile_grid(FILM, SIDE) == (2, 3)
    met = np.bincount(tile_pixels(FILM, SIDE).reshape(-1)).reshape(FILM.height, FILM.width)
    # The last tile begins SIDE before the border: columns 5 to 7 and rows 11 to 15 come twice.
    expected = np.ones((FILM.height, FILM.width), int)
    expected[:, 5:8] *= 2
    expected[11:16] *= 2
    np.testing.assert_array_equal(met, expected)


def test_a_tile_is_a_square_row_after_row():
    y, x = np.divmod(tile_pixels(FILM, SIDE).reshape(6, SIDE, SIDE), FILM.width)
    np.testing.assert_array_equal(x - x[:, :1, :1], np.broadcast_to(np.arange(SIDE), x.shape))
    np.testing.assert_array_equal(y - y[:, :1, :1], np.swapaxes(x - x[:, :1, :1], 1, 2))
    np.testing.assert_array_equal(x[:, 0, 0], [0, 5, 0, 5, 0, 5])
    np.testing.assert_array_equal(y[:, 0, 0], [0, 0, 8, 8, 11, 11])


def test_the_tiles_of_a_picture_make_the_picture(picture):
    pixels = tile_pixels(FILM, SIDE)
    np.testing.assert_array_equal(
        join(cut(picture, pixels), places_in_tiles(pixels, FILM)), picture
    )
    color = np.stack([picture, -picture, 2 * picture], axis=-1)
    assert cut(color, pixels).shape == (6, SIDE**2, 3)
    np.testing.assert_array_equal(join(cut(color, pixels), places_in_tiles(pixels, FILM)), color)


def test_every_pixel_is_found_in_its_tile(picture):
    row, column = np.mgrid[: FILM.height, : FILM.width].reshape(2, -1)
    tile, place = tile_of(FILM, SIDE, column, row)
    np.testing.assert_array_equal(
        cut(picture, tile_pixels(FILM, SIDE))[tile, place], picture[row, column]
    )


def test_a_tile_larger_than_the_picture_is_refused():
    with pytest.raises(CaptureError, match="at most the picture's smaller side, got 14"):
        tile_grid(FILM, FILM.width + 1)


@pytest.mark.parametrize(("side", "bundle"), [(8, 8), (16, 8), (24, 8), (32, 8), (32, 16)])
def test_a_large_tile_is_stored_bundle_after_bundle(side, bundle):
    order = tile_order(side, bundle)
    np.testing.assert_array_equal(np.sort(order), np.arange(side**2))
    np.testing.assert_array_equal(order[tile_places(side, bundle)], np.arange(side**2))
    row, column = np.divmod(order.reshape(-1, bundle, bundle), side)
    inside = np.arange(bundle)
    np.testing.assert_array_equal(row - row[:, :1, :1], np.broadcast_to(inside[:, None], row.shape))
    np.testing.assert_array_equal(column - column[:, :1, :1], np.broadcast_to(inside, row.shape))


def test_four_bundles_in_turn_are_a_square():
    for part in np.divmod(tile_order(32, 8).reshape(4, 256), 32):
        np.testing.assert_array_equal(np.ptp(part, axis=1), 15)


def test_every_pixel_is_found_in_its_large_tile():
    film = Film(37, 50, "center")
    values = np.arange(film.height * film.width).reshape(film.height, film.width)
    row, column = np.mgrid[: film.height, : film.width].reshape(2, -1)
    tile, place = tile_of(film, 32, column, row, 8)
    pixels = tile_pixels(film, 32, 8)
    np.testing.assert_array_equal(cut(values, pixels)[tile, place], values[row, column])
    np.testing.assert_array_equal(join(cut(values, pixels), places_in_tiles(pixels, film)), values)


def test_a_tile_fits_into_the_picture_and_is_whole_bundles():
    assert fitting_side(Film(135, 240, "center"), 32, 8) == 32
    assert fitting_side(Film(30, 240, "center"), 32, 8) == 24
    assert fitting_side(Film(135, 240, "center"), 20, 8) == 16
    assert fitting_side(Film(135, 240, "center"), 4, 8) == 8
    with pytest.raises(ValueError, match="multiple of 8, got 12"):
        tile_order(12, 8)
