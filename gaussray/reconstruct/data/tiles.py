"""Square tiles of pictures, of which a training step draws some.

A tile of `side` x `side` pixels consists of ray bundles of `bundle` x `bundle` pixels. Its pixels
are stored in the order in which their rays are traced: bundle after bundle along the Morton curve,
row after row within a bundle. Without `bundle` a tile is one bundle.
"""

import numpy as np
from jaxtyping import Int, Shaped

from gaussray.camera.film import Film
from gaussray.capture.errors import CaptureError
from gaussray.tracer.bundle import morton_tiles


def fitting_side(film: Film, wanted: int, bundle: int) -> int:
    """The side of a tile in pixels: a multiple of the bundle's side, at least one bundle.

    Args:
        film: size of a picture; the tile is no larger than its smaller side.
        wanted: the largest side, in pixels.
        bundle: pixels along the side of a ray bundle.
    """
    return max(min(wanted, film.width, film.height) // bundle, 1) * bundle


def tile_order(side: int, bundle: int | None = None) -> Int[np.ndarray, " pixels"]:
    """Pixel (row x side + column) at every place of a tile.

    Args:
        side: pixels along the side of a tile.
        bundle: pixels along the side of a ray bundle; None: the tile is one bundle.

    Raises:
        ValueError: `side` is not a multiple of `bundle`.
    """
    bundle = bundle or side
    if side == bundle:
        return np.arange(side * side, dtype=np.int32)
    if side % bundle:
        raise ValueError(f"A tile's side must be a multiple of {bundle}, got {side}.")
    levels = 0
    while bundle * 4**levels < side:
        levels += 1
    order = morton_tiles(side, side, bundle, levels)
    return order[order >= 0]


def tile_places(side: int, bundle: int | None = None) -> Int[np.ndarray, " pixels"]:
    """Place in a tile of every pixel, row after row: the inverse of `tile_order`.

    Args:
        side: pixels along the side of a tile.
        bundle: pixels along the side of a ray bundle; None: the tile is one bundle.
    """
    return np.argsort(tile_order(side, bundle)).astype(np.int32)


def tile_grid(film: Film, side: int) -> tuple[int, int]:
    """Columns and rows of tiles. If the side does not divide the picture's, the last tiles overlap
    their neighbours.

    Args:
        film: size of a picture.
        side: pixels along the side of a tile.

    Raises:
        CaptureError: the picture is smaller than a tile.
    """
    if min(film.height, film.width) < side:
        raise CaptureError(
            f"trace.bundle must be at most the picture's smaller side, got {side} for a picture of "
            f"{film.width} x {film.height}."
        )
    return -(-film.width // side), -(-film.height // side)


def tile_pixels(
    film: Film, side: int, bundle: int | None = None
) -> Int[np.ndarray, "tiles pixels"]:
    """Which pixels each tile holds (row x width + column); tiles are listed row after row, their
    pixels in `tile_order`.

    Args:
        film: size of a picture.
        side: pixels along the side of a tile.
        bundle: pixels along the side of a ray bundle; None: a tile is one bundle.
    """
    columns, rows = tile_grid(film, side)
    left = np.minimum(np.arange(columns) * side, film.width - side)
    top = np.minimum(np.arange(rows) * side, film.height - side)
    corner = top[:, None] * film.width + left[None, :]
    row, column = np.divmod(tile_order(side, bundle), side)
    inside = row * film.width + column
    return (corner.reshape(-1, 1) + inside.reshape(1, -1)).astype(np.int32)


def tile_of(
    film: Film,
    side: int,
    column: Int[np.ndarray, " points"],
    row: Int[np.ndarray, " points"],
    bundle: int | None = None,
) -> tuple[Int[np.ndarray, " points"], Int[np.ndarray, " points"]]:
    """A tile that holds each pixel, and the pixel's place in it.

    Args:
        film: size of a picture.
        side: pixels along the side of a tile.
        column: column of each pixel in the picture.
        row: row of each pixel in the picture.
        bundle: pixels along the side of a ray bundle; None: a tile is one bundle.
    """
    columns, _ = tile_grid(film, side)
    left = np.minimum(column // side * side, film.width - side)
    top = np.minimum(row // side * side, film.height - side)
    place = tile_places(side, bundle)[(row - top) * side + column - left]
    return row // side * columns + column // side, place


def cut(
    picture: Shaped[np.ndarray, "h w *channels"], pixels: Int[np.ndarray, "tiles pixels"]
) -> Shaped[np.ndarray, "tiles pixels *channels"]:
    """Cut a picture into tiles.

    Args:
        picture: the picture: colours, or a mask without channels.
        pixels: which pixels each tile holds (`tile_pixels`).
    """
    # Four times as fast as an index.
    return np.take(picture.reshape(-1, *picture.shape[2:]), pixels, axis=0)


def join(
    tiles: Shaped[np.ndarray, "tiles pixels *channels"], places: Int[np.ndarray, "h w"]
) -> Shaped[np.ndarray, "h w *channels"]:
    """Join tiles to a picture: the inverse of `cut`.

    Args:
        tiles: the tiles of one picture.
        places: where among the pixels of all tiles each of the picture is (`places_in_tiles`).
    """
    return np.take(tiles.reshape(-1, *tiles.shape[2:]), places, axis=0)


def places_in_tiles(pixels: Int[np.ndarray, "tiles pixels"], film: Film) -> Int[np.ndarray, "h w"]:
    """Where among the pixels of all tiles each pixel of a picture is; the later place of two.

    Args:
        pixels: which pixels each tile holds (`tile_pixels`).
        film: size of the picture.
    """
    places = np.empty((film.height, film.width), np.int32)
    places.reshape(-1)[pixels.reshape(-1)] = np.arange(pixels.size, dtype=np.int32)
    return places
