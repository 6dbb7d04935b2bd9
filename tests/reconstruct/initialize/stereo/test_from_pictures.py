"""Points of pictures: the same by threads, and none of a plain backdrop."""

from functools import partial

import numpy as np
from square_film import SIDE, TIMES, film_of_square
from textured_plane import PLACES, QUICK, SIZE, perspective, places_on_plane, rig, seen

from gaussray.color import srgb_encode
from gaussray.reconstruct.data.backdrop import like_backdrop
from gaussray.reconstruct.data.pictures import Footage
from gaussray.reconstruct.data.tiles import cut, tile_pixels
from gaussray.reconstruct.initialize.stereo import from_pictures
from gaussray.reconstruct.initialize.stereo.from_pictures import (
    moving_points,
    points_from_pictures,
)
from gaussray.reconstruct.initialize.stereo.points import StereoPoints


def test_threads_find_the_same_points_in_the_same_order(monkeypatch):
    footage, _ = film_of_square()

    def point(frame):
        vector, number = np.full((1, 3), frame, np.float32), np.ones(1, np.float32)
        return StereoPoints(vector, vector, 0 * vector, number, number, number)

    # One camera sees all of a picture move: a point for each time.
    def moved(frame):
        return np.full((SIZE, SIZE), frame < 5)

    asked = partial(moving_points, footage, TIMES, moved=moved, alone=point)
    alone = asked()
    monkeypatch.setattr(from_pictures, "_threads", lambda: 3)
    together = asked()
    assert [cloud.points.position[0, 0] for cloud in alone] == [0, 1, 2, 3, 4]
    for one, other in zip(alone, together, strict=True):
        assert one.time == other.time
        np.testing.assert_array_equal(one.points.position, other.points.position)
        np.testing.assert_array_equal(one.velocity, other.velocity)


def test_points_of_a_plain_backdrop_are_left_out():
    """The plane's middle in the air before white: without it, white matches at any distance."""
    cameras = rig(perspective(), PLACES)
    pictures = np.asarray(seen(cameras), np.float32).copy()
    places, _ = places_on_plane(cameras)
    pictures[np.abs(places).max(axis=-1) > 0.6] = 1
    pixels = tile_pixels(cameras.film, SIDE)
    tiles = np.stack(
        [cut((255 * picture).round().astype(np.uint8), pixels) for picture in pictures]
    )
    names = np.array([f"cam{k}" for k in range(len(PLACES))])
    found = points_from_pictures(Footage(tiles, None, cameras, names, SIDE), options=QUICK)
    assert len(found.position) > 100
    assert not like_backdrop(srgb_encode(found.color), (1.0, 1.0, 1.0)).any()
    assert np.percentile(np.abs(found.position), 95) < 0.7
