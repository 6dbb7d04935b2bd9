"""Pictures as square tiles, the pieces in which training looks at them."""

import numpy as np
from jaxtyping import Int, Shaped

from gaussray.camera.film import Film
from gaussray.capture.errors import CaptureError


def tile_grid(film: Film, side: int) -> tuple[int, int]:
    """Columns and rows of tiles; the last ones overlap their neighbours where nothing divides."""
    if min(film.height, film.width) < side:
        raise CaptureError(
            f"trace.bundle must be at most the picture's smaller side, got {side} for a picture of "
            f"{film.width} x {film.height}."
        )
    return -(-film.width // side), -(-film.height // side)


def tile_pixels(film: Film, side: int) -> Int[np.ndarray, "tiles pixels"]:
    """Which pixels each tile holds (row x width + column), a tile row after row, and its pixels
    too."""
    columns, rows = tile_grid(film, side)
    left = np.minimum(np.arange(columns) * side, film.width - side)
    top = np.minimum(np.arange(rows) * side, film.height - side)
    corner = top[:, None] * film.width + left[None, :]
    inside = np.arange(side)[:, None] * film.width + np.arange(side)[None, :]
    return (corner.reshape(-1, 1) + inside.reshape(1, -1)).astype(np.int32)


def tile_of(
    film: Film, side: int, column: Int[np.ndarray, " points"], row: Int[np.ndarray, " points"]
) -> tuple[Int[np.ndarray, " points"], Int[np.ndarray, " points"]]:
    """A tile that holds the pixel, and the pixel's place in it."""
    columns, _ = tile_grid(film, side)
    left = np.minimum(column // side * side, film.width - side)
    top = np.minimum(row // side * side, film.height - side)
    return row // side * columns + column // side, (row - top) * side + column - left


def cut(
    picture: Shaped[np.ndarray, "h w *channels"], pixels: Int[np.ndarray, "tiles pixels"]
) -> Shaped[np.ndarray, "tiles pixels *channels"]:
    """The tiles of a picture."""
    return picture.reshape(-1, *picture.shape[2:])[pixels]


def join(
    tiles: Shaped[np.ndarray, "tiles pixels *channels"],
    pixels: Int[np.ndarray, "tiles pixels"],
    film: Film,
) -> Shaped[np.ndarray, "h w *channels"]:
    """The picture of which these are the tiles."""
    picture = np.empty((film.height * film.width, *tiles.shape[2:]), tiles.dtype)
    picture[pixels] = tiles
    return picture.reshape(film.height, film.width, *tiles.shape[2:])
