"""Names, lenses, errors and neighbours of the cameras of a placement."""

import numpy as np
import pytest

from gaussray.prepare.features import MatchingPicture
from gaussray.prepare.placed_cameras import (
    camera_lenses,
    neighbour_angles,
    picture_errors,
    picture_name,
)
from gaussray.prepare.placement import Placement
from gaussray.prepare.sparse_model import Observations, SparseModel


def placed(pictures, poses, points=(), picture=(), error=(), still=()):
    """Pictures with poses of one size; all observations are of the first point."""
    picture, zeros = np.array(picture, int), np.zeros(len(picture), int)
    seen = Observations(zeros, picture, zeros, np.zeros((len(picture), 2)), np.array(error, float))
    files = [one.file for one in pictures]
    lenses = [{"w": 10 * k} for k in range(len(poses))]
    points = np.array(points, float).reshape(-1, 3)
    model = SparseModel(files[: len(poses)], np.array(poses), lenses, points, seen)
    named = dict(zip(files, pictures, strict=True))
    return Placement(model, named, {}, {}, still=frozenset(still), known=False)


def test_photographs_are_named_by_their_files_and_frames_of_videos_by_their_number():
    def name(camera, photograph, still=()):
        last = MatchingPicture("3.png", camera, 3, (4, 3), photograph)
        other = MatchingPicture("0.png", "sub", 0, (4, 3), "a.jpg")
        return picture_name(last, placed([other, last], np.zeros((1, 3, 4)), still=still))

    assert name("sub", "frame-07.color.jpg") == "frame-07.color.jpg"
    assert name("other", "frame-07.color.jpg") == "other/frame-07.color.jpg"
    assert name("other", "") == "other 3"
    assert name("other", "frame-07.color.jpg", still=["other"]) == "other"


def test_errors_of_a_camera_are_over_all_its_pictures():
    cameras = ["a", "b", "a", "c"]
    pictures = [MatchingPicture(f"{k}.png", name, k, (4, 3)) for k, name in enumerate(cameras)]
    picture, error = [0, 0, 1, 2, 2, 2], [1.0, 2.0, 9.0, 3.0, 4.0, 5.0]
    placement = placed(pictures, np.zeros((4, 3, 4)), picture=picture, error=error)
    found = picture_errors(placement)
    # Five observations of two pictures: two each, in whole numbers.
    assert found["a"] == pytest.approx((2, 3.0, 4.6)) and found["b"] == (1, 9.0, 9.0)
    assert found["c"][0] == 0 and np.isnan(found["c"][1:]).all()
    assert camera_lenses(placement)["b"] == {"w": 10}


def test_angles_between_neighbours_do_not_change_with_the_world():
    """Cameras at 0, 30 and 100 degrees of a circle, in two worlds of other size, turn and place."""
    turns = np.radians([0.0, 30.0, 100.0])
    centres = np.stack([np.cos(turns), np.sin(turns), 0 * turns], axis=1)
    points = np.concatenate([np.eye(3), -np.eye(3)])
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    pictures = [MatchingPicture(f"{k}.png", "a", k, (4, 3)) for k in range(3)]
    for size, rotation, shift in ((1.0, np.eye(3), 0.0), (7.0, turn, 3.0)):
        moved, cloud = (size * x @ rotation.T + shift for x in (centres, points))
        poses = np.stack([np.column_stack([np.eye(3), -c]) for c in moved])
        found = neighbour_angles(placed(pictures, poses, cloud))
        assert found == pytest.approx([30, 30, 70])
