"""Which pictures stereo sees: medians of still cameras, all frames of moving ones, what moves."""

import dataclasses

import jax
import numpy as np
from square_film import ROWS, film_of_square
from textured_plane import SIZE

from gaussray.capture.temporal_median import temporal_median
from gaussray.reconstruct.data import still_cameras
from gaussray.reconstruct.data.still_cameras import MedianMasks, still_camera_count
from gaussray.reconstruct.initialize.stereo.view_sets import moving_views, still_views


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


def test_leaves_of_views_are_those_of_their_frames():
    footage, _ = film_of_square()
    cameras = still_views(footage).cameras
    expected = jax.tree.map(lambda leaf: leaf[np.array([0, 5])], footage.camera)
    assert all(
        np.array_equal(a, b)
        for a, b in zip(jax.tree.leaves(cameras), jax.tree.leaves(expected), strict=True)
    )
