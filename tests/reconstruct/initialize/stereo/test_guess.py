"""Points at the distances where the colours of views agree best: near the surface of a plane that
is seen from far apart, in its colours, and none of a plain backdrop."""

import numpy as np
import pytest
from textured_plane import NORMAL, OFFSET, PLACES, SIZE, perspective, rig, seen

from gaussray.color import srgb_encode
from gaussray.reconstruct.initialize.stereo.guess import guessed_points
from gaussray.reconstruct.initialize.stereo.view_sets import StereoViewSet


FACTOR = 2
# Median distance from the plane, in distances of the cameras: pixels of twice the size, whose
# colours vary across the window that votes.
NEAR = 0.06
# Colours of a picture of 8 bits, averaged in linear light and encoded again.
CLOSE = 0.02


def pictures(views=4, shown=None):
    cameras = rig(perspective(), PLACES[:views])
    picture = np.asarray(seen(cameras)) if shown is None else shown
    return StereoViewSet(picture, None, cameras, np.arange(views))


def guessed(shown):
    return guessed_points(shown, count=len(shown.frames) * (SIZE // FACTOR) ** 2, seed=0)


def test_points_lie_near_the_surface_that_all_views_show():
    shown = pictures()
    found = guessed(shown)
    assert len(found.position) == 4 * (SIZE // FACTOR) ** 2
    away = np.linalg.norm(np.asarray(PLACES[:4]), axis=1).mean()
    height = np.abs(found.position @ NORMAL - OFFSET)
    assert np.median(height) < NEAR * away
    # No better than that are distances that agree with no picture.
    other = np.stack([np.roll(x, 11 * k, axis=(0, 1)) for k, x in enumerate(shown.pictures)])
    wrong = pictures(shown=other)
    assert np.median(np.abs(guessed(wrong).position @ NORMAL - OFFSET)) > 2 * np.median(height)


def test_a_single_view_gets_its_colours_at_one_distance():
    shown = pictures(1)
    found = guessed(shown)
    origin = np.asarray(shown.cameras.trajectory.translation)[0, 0]
    distance = np.linalg.norm(found.position - origin, axis=1)
    assert distance.max() < 1.1 * distance.min() * 1.1
    color = srgb_encode(found.color).reshape(SIZE // FACTOR, SIZE // FACTOR, 3)
    whole = shown.pictures[0].astype(float) / (255 if shown.pictures.dtype == np.uint8 else 1)
    small = whole.reshape(SIZE // FACTOR, FACTOR, SIZE // FACTOR, FACTOR, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(color, small, atol=CLOSE)


@pytest.mark.parametrize("level", [0, 255])
def test_a_plain_backdrop_gets_no_points(level):
    shown = pictures().pictures.copy()
    whole = shown.dtype.type(level if shown.dtype == np.uint8 else level / 255)
    shown[:, :, : SIZE // 2] = whole
    count = 4 * (SIZE // FACTOR) ** 2
    plain = (level / 255,) * 3
    found = guessed_points(pictures(shown=shown), count=count, seed=0, plain=plain)
    # Colours of the plane are between the two.
    assert len(found.position) == count // 2
    everything = pictures(shown=np.full_like(shown, whole))
    assert not len(guessed_points(everything, count=count, seed=0, plain=plain).position)
