"""Which pictures stereo sees: medians of still cameras, all frames of moving ones, what moves."""

import dataclasses
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from textured_plane import PLACES, SIZE, perspective, rig

from gaussray.capture.points import Points
from gaussray.capture.temporal_median import temporal_median
from gaussray.reconstruct.data import still_cameras
from gaussray.reconstruct.data.pictures import Footage
from gaussray.reconstruct.data.still_cameras import MedianMasks, still_camera_count
from gaussray.reconstruct.data.tiles import cut, tile_pixels
from gaussray.reconstruct.initialize.initializer import filled_up
from gaussray.reconstruct.initialize.stereo import from_pictures
from gaussray.reconstruct.initialize.stereo.from_pictures import (
    moving_points,
    moving_views,
    still_views,
)
from gaussray.reconstruct.initialize.stereo.points import StereoPoints


TIMES = (0.0, 0.25, 0.5, 0.75, 1.0)
SIDE = 8
# Where the square stands in frame k: columns 8 k to 8 k + 8.
ROWS = slice(16, 28)


def film_of_square(*, moving_camera=False):
    """Two cameras of five frames each: an even background, and a white square that moves; the
    second camera may move too."""
    base = rig(perspective(), [PLACES[0]] * 5 + [PLACES[1]] * 5)
    times = jnp.asarray(TIMES * 2, jnp.float32)
    base = eqx.tree_at(lambda c: c.time, base, times)
    if moving_camera:
        shift = jnp.arange(5.0)[:, None, None] * jnp.asarray([0.1, 0, 0])[None, None]
        path = base.trajectory.translation
        path = path.at[5:].add(shift)
        base = eqx.tree_at(lambda c: c.trajectory.translation, base, path)
    pictures = np.full((10, SIZE, SIZE, 3), 60, np.uint8)
    for k in range(10):
        pictures[k, ROWS, 8 * (k % 5) : 8 * (k % 5) + 8] = 255
    pixels = tile_pixels(base.film, SIDE)
    tiles = np.stack([cut(picture, pixels) for picture in pictures])
    names = np.array(["a"] * 5 + ["b"] * 5)
    fields = {field.name for field in dataclasses.fields(Footage)}
    extra = {"bundle": SIDE} if "bundle" in fields else {}
    return Footage(tiles, None, base, names, SIDE, **extra), pictures


def test_what_passes_by_is_not_in_the_medians_of_still_cameras():
    footage, _ = film_of_square()
    views = still_views(footage)
    assert views.frames.tolist() == [0, 5]
    np.testing.assert_array_equal(views.pictures, 60)


def test_a_median_is_found_once_for_all_that_ask(monkeypatch):
    found = []

    def noted(pictures, visible=None):
        found.append(len(pictures))
        return temporal_median(pictures, visible)

    monkeypatch.setattr(still_cameras, "temporal_median", noted)
    footage, _ = film_of_square()
    for _ in range(2):
        still_views(footage)
        MedianMasks(footage)(3)
    assert found == [5, 5]


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


def test_every_frame_of_a_moving_camera_is_a_view_of_its_own():
    footage, pictures = film_of_square(moving_camera=True)
    views = still_views(footage)
    assert views.frames.tolist() == [0, 5, 6, 7, 8, 9]
    np.testing.assert_array_equal(views.pictures[1:], pictures[5:])
    places = np.asarray(views.cameras.trajectory.translation)[1:, 0, 0]
    assert np.all(np.diff(places) > 0.09)


def test_pictures_of_one_instant_are_views_as_they_are():
    footage, pictures = film_of_square()
    once = dataclasses.replace(footage, name=np.array([f"cam{k}" for k in range(10)]))
    np.testing.assert_array_equal(still_views(once).pictures, pictures)


def test_moving_pixels_are_those_that_differ_from_the_median():
    footage, pictures = film_of_square()
    found = moving_views(footage, 0.5, MedianMasks(footage))
    assert found is not None
    views, moved = found
    square = np.zeros((SIZE, SIZE), bool)
    square[ROWS, 16:24] = True
    assert views.frames.tolist() == [2, 7] and views.masks is not None
    # The corners have few moving neighbours.
    assert (moved[0] & ~square).sum() == 0 and (square & ~moved[0]).sum() <= 4
    assert views.masks[0].sum() > square.sum() and (views.masks[0] | ~moved[0]).all()
    np.testing.assert_array_equal(views.pictures[0], pictures[2])


def test_a_camera_that_moves_counts_everywhere_and_shows_nothing_that_moves():
    footage, pictures = film_of_square(moving_camera=True)
    masks = MedianMasks(footage)
    assert still_camera_count(footage) == 1 and masks(7) is None and masks(2) is not None
    views, moved = moving_views(footage, 0.5, masks)
    assert views.frames.tolist() == [2, 7] and views.masks is not None
    assert moved[0].any() and not views.masks[0].all()
    assert not moved[1].any() and views.masks[1].all()
    np.testing.assert_array_equal(views.pictures[1], pictures[7])


def test_without_a_still_camera_that_sees_something_move_there_are_no_views():
    footage, _ = film_of_square(moving_camera=True)
    unmoved = np.zeros((SIZE, SIZE), bool)
    assert moving_views(footage, 0.5, lambda frame: None) is None
    assert moving_views(footage, 0.5, lambda frame: unmoved if frame < 5 else None) is None
    assert moving_views(footage, 0.5, lambda frame: unmoved) is None


def test_any_pixels_may_be_told_to_move():
    footage, pictures = film_of_square(moving_camera=True)
    views, moved = moving_views(footage, 0.5, lambda frame: pictures[frame][..., 0] == 255)
    assert views.frames.tolist() == [2, 7]
    np.testing.assert_array_equal(moved, pictures[[2, 7], ..., 0] == 255)


def test_stereo_fills_up_known_points_only_where_they_leave_surfaces_empty():
    x, y = np.meshgrid(np.arange(20.0), np.arange(10.0))
    plane = np.stack([x.ravel(), y.ravel(), np.zeros(200)], axis=1).astype(np.float32)
    known = Points(plane[plane[:, 0] < 10], np.zeros((100, 3), np.float32))
    matched = Points(plane + np.float32([0.2, 0.1, 0]), np.ones((200, 3), np.float32))
    whole = filled_up(known, matched)
    np.testing.assert_array_equal(whole.position[:100], known.position)
    added = whole.position[100:]
    assert len(added) == 100 and added[:, 0].min() > 10 and np.all(whole.color[100:] == 1)


def test_leaves_of_views_are_those_of_their_frames():
    footage, _ = film_of_square()
    cameras = still_views(footage).cameras
    expected = jax.tree.map(lambda leaf: leaf[np.array([0, 5])], footage.camera)
    assert all(
        np.array_equal(a, b)
        for a, b in zip(jax.tree.leaves(cameras), jax.tree.leaves(expected), strict=True)
    )
