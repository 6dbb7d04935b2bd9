"""The distance at which views agree on a colour: that of the surface where colours vary, however
wrong the usual distance, and the usual one where they do not."""

import numpy as np
import pytest
from textured_plane import NORMAL, OFFSET, PLACES, SIZE, perspective, rig, seen

from gaussray.reconstruct.initialize.stereo.agreement import agreeing_distance
from gaussray.reconstruct.initialize.stereo.views import rays, stereo_views


FACTOR = 2
# Half a step of distances (9 %), and as much again: large pixels vary across the window that votes.
NEAR = 0.09
# Half a step of distances on either side of the nearest one.
STEP = 1.1


def views_of(shown, cameras):
    return stereo_views(shown, cameras, None, factor=FACTOR)


@pytest.mark.parametrize("usual", [0.6, 20.0])
def test_a_textured_surface_is_found_whatever_is_usual(usual):
    cameras = rig(perspective(), PLACES[:5])
    views = views_of(np.asarray(seen(cameras)), cameras)
    found = agreeing_distance(views, 0, np.asarray(usual), np.random.default_rng(0))
    own = views[0]
    ray = np.asarray(rays(own.lens, own.world_from_camera, own.size, own.factor))
    true = (OFFSET - NORMAL @ np.asarray(own.origin)) / np.einsum("i,ihw->hw", NORMAL, ray)
    assert found.shape == (SIZE // FACTOR,) * 2
    assert np.median(np.abs(np.log(found / true))) < NEAR


def test_what_is_plain_is_at_the_usual_distance():
    cameras = rig(perspective(), PLACES[:5])
    plain = np.full((5, SIZE, SIZE, 3), 128, np.uint8)
    usual = np.full((SIZE // FACTOR,) * 2, 2.5)
    usual[:, : SIZE // 4] = 3.5
    found = agreeing_distance(views_of(plain, cameras), 0, usual, np.random.default_rng(0))
    # All views see the middle of the picture, at both distances.
    ratio = (found / usual)[8:16, 8:16]
    assert ratio.max() < STEP and ratio.min() > 1 / STEP


def test_a_view_alone_takes_the_usual_distance():
    cameras = rig(perspective(), PLACES[:1])
    views = views_of(np.asarray(seen(cameras)), cameras)
    found = agreeing_distance(views, 0, np.asarray(2.0), np.random.default_rng(0))
    assert found.shape == (SIZE // FACTOR,) * 2 and (found == 2.0).all()
