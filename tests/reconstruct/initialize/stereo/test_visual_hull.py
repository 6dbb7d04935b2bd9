"""Which places masks of an object leave: those that most pictures show."""

import numpy as np
import pytest
from textured_plane import SIZE, perspective, rig

from gaussray.reconstruct.initialize.stereo.view_sets import StereoViewSet
from gaussray.reconstruct.initialize.stereo.visual_hull import outside_hull


# Cameras at these places look at the origin; a mask shows the middle of their pictures.
AROUND = [(3.0 * np.cos(a), 3.0 * np.sin(a), 2.0) for a in np.linspace(0, 2 * np.pi, 8)[:-1]]


def pictures(masks):
    cameras = rig(perspective(), AROUND)
    shown = np.zeros((len(AROUND), SIZE, SIZE, 3), np.uint8)
    return StereoViewSet(shown, np.asarray(masks), cameras, np.arange(len(AROUND)))


def middle():
    mask = np.zeros((SIZE, SIZE), bool)
    mask[3 * SIZE // 8 : 5 * SIZE // 8, 3 * SIZE // 8 : 5 * SIZE // 8] = True
    return mask


PLACES = np.array([(0, 0, 0), (0.05, -0.05, 0.05), (0.9, 0, 0), (0, -0.9, 0.2)], np.float32)


def test_places_that_masks_hide_are_outside():
    outside = outside_hull(pictures([middle()] * len(AROUND)), PLACES)
    np.testing.assert_array_equal(outside, [False, False, True, True])


@pytest.mark.parametrize(("wrong", "lost"), [(1, False), (2, False), (3, True)])
def test_a_few_wrong_masks_take_nothing_away(wrong, lost):
    masks = [np.zeros_like(middle())] * wrong + [middle()] * (len(AROUND) - wrong)
    assert outside_hull(pictures(masks), PLACES)[:2].tolist() == [lost, lost]


def test_what_no_picture_contains_is_not_outside():
    assert not outside_hull(pictures([middle()] * len(AROUND)), np.float32([(0, 0, 9)])).any()
