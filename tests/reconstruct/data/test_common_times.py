"""Pictures of cameras that nothing synchronises get common times, and keep when they were taken."""

import dataclasses

import numpy as np
import pytest
import toy

from gaussray.camera.camera import camera_rays
from gaussray.capture.formats.paired import read_capture
from gaussray.reconstruct.auto.choice import motions
from gaussray.reconstruct.auto.machine import Machine
from gaussray.reconstruct.data.common_times import (
    common_times,
    common_times_sentence,
    with_common_times,
)
from gaussray.reconstruct.options import ReconstructOptions


# A picture each second by each of four cameras, in seconds.
OFFSETS, COUNT = np.array([0.0, 0.31, 0.52, 0.77]), 8
# Times of 64 bits, and of the cameras' 32.
FLOOR, FLOOR32 = 1e-9, 1e-6


def clocks(offsets=OFFSETS, gap=1.0, count=COUNT):
    """Times and numbers of the cameras of all pictures."""
    times = np.array([offset + gap * np.arange(count) for offset in offsets])
    return times.reshape(-1), np.repeat(np.arange(len(offsets)), count)


def test_each_time_has_a_picture_of_each_camera():
    times, place = clocks()
    found = common_times(times, place)
    assert found is not None
    # Of all clocks, continued to both sides, the one that is nearest to the others.
    least = min(np.sum(((times - own + 0.5) % 1.0 - 0.5) ** 2) for own in OFFSETS)
    assert np.sum((found - times) ** 2) == pytest.approx(least, abs=FLOOR)
    distinct, pictures = np.unique(np.round(found, 9), return_counts=True)
    assert len(distinct) <= COUNT + 1 and np.median(pictures) == len(OFFSETS)
    assert np.abs(found - times).max() <= 0.5 + FLOOR
    for camera in range(len(OFFSETS)):
        assert len(np.unique(found[place == camera])) == COUNT


def test_order_does_not_count():
    times, place = clocks()
    order = np.random.default_rng(0).permutation(len(times))
    shuffled, found = common_times(times[order], place[order]), common_times(times, place)
    assert shuffled is not None and found is not None
    np.testing.assert_allclose(shuffled, found[order], atol=FLOOR)


def test_a_slower_camera_has_pictures_at_some_of_the_times():
    fast, slow = np.arange(9.0), 0.4 + 2.0 * np.arange(4)
    times, place = np.concatenate([fast, slow]), np.repeat([0, 1], [9, 4])
    found = common_times(times, place)
    assert found is not None
    np.testing.assert_allclose(found[place == 0], fast)
    np.testing.assert_allclose(found[place == 1], [0.0, 2.0, 4.0, 6.0])


def test_clocks_that_differ_a_little_agree_even_where_most_times_have_several_pictures():
    times, place = clocks(np.array([0.0, 0.0, 0.0, 0.02]))
    found = common_times(times, place)
    assert found is not None and len(np.unique(found)) == COUNT


@pytest.mark.parametrize(
    ("times", "place"),
    [
        # One clock.
        clocks(np.zeros(4)),
        # Half of the cameras halfway between the others: each time has two pictures.
        clocks(np.array([0.0, 0.0, 0.5, 0.5])),
        # A camera that is elsewhere in each picture.
        (np.arange(12.0), np.arange(12)),
        # One camera that stands still, and pictures from elsewhere.
        (np.arange(12.0), np.repeat([0, 1, 2, 3, 4, 5, 6], [6, 1, 1, 1, 1, 1, 1])),
        # Two films of one time after another.
        (np.arange(12.0), np.repeat([0, 1], 6)),
    ],
    ids=["synchronised", "halfway", "on its way", "one camera", "one after another"],
)
def test_other_pictures_keep_their_times(times, place):
    found = common_times(times, place)
    assert found is None or np.array_equal(found, times)


@pytest.fixture(scope="module")
def late(tmp_path_factory):
    """A capture whose cameras are late, each by a time of its own."""
    folder = tmp_path_factory.mktemp("late")
    capture = read_capture(toy.write_capture(folder, toy.scene(), times=(0.0, 0.3, 0.6, 0.9)))
    names = sorted({view.camera_name for view in capture.views})

    def own(view):
        time = view.time + 0.1 * names.index(view.camera_name) / len(names)
        camera = dataclasses.replace(view.camera, time=toy.single(time))
        return dataclasses.replace(view, camera=camera, time=time)

    return dataclasses.replace(capture, views=[own(view) for view in capture.views])


def test_rays_keep_the_time_at_which_they_were_recorded(late):
    found = with_common_times(late)
    train = [view.split == "train" for view in late.views]
    assert len({v.time for v, t in zip(found.views, train, strict=True) if t}) == 4
    pixel, u = toy.single([[1.0, 2.0], [3.0, 0.0]]), toy.single(np.full((2, 5), 0.5))
    for before, after, is_train in zip(late.views, found.views, train, strict=True):
        if not is_train:
            assert after is before
            continue
        first, second = (camera_rays(view.camera, pixel, u) for view in (before, after))
        np.testing.assert_allclose(second.time, first.time, atol=FLOOR32)
        np.testing.assert_array_equal(second.direction, first.direction)
    # Again there is nothing to do.
    assert with_common_times(found) is found


def test_pictures_of_common_times_are_fitted_as_those_of_synchronised_cameras(late):
    machine, options = Machine(gpu=False), ReconstructOptions()
    assert motions(late, options, machine) == ("from_rest",)
    found = with_common_times(late)
    assert motions(found, options, machine)[0] in ("deformation", "transient")
    assert "at 4 times" in common_times_sentence(late, found)
