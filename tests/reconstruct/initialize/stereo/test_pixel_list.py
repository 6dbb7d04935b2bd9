"""Stereo of the pixels that count alone: the same points as of whole pictures, by one program for
any number of them."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import KDTree
from textured_plane import (
    NORMAL,
    OFFSET,
    PLACES,
    QUICK,
    SIZE,
    perspective,
    places_on_plane,
    rig,
    seen,
)

from gaussray.reconstruct.initialize.stereo import matching
from gaussray.reconstruct.initialize.stereo.matching import stereo_points
from gaussray.reconstruct.initialize.stereo.pixel_list import pixel_list


pytestmark = pytest.mark.usefixtures("optimized_programs")

# Half of the depth between neighbours 0.7 apart that a pixel spans on the plane.
HALF_A_STEP = 0.12
# Planes spread from pixel to pixel. Those from pixels that are not refined, and the points that
# these confirm, are missing: few, at the movers' edges.
MOST = 0.9
# Places of the same points from the same numbers, rounded in another order.
SAME = 1e-6
# Middles and radii of what moves on the plane: the second is cut by the pictures' left border.
MOVERS = ((-0.8, 0.1, 0.35), (1.25, -0.3, 0.4))


def masks_of(cameras, movers):
    """The pixels that show discs (x, y, radius) on the plane."""
    places, _ = places_on_plane(cameras)
    discs = [np.hypot(places[..., 0] - x, places[..., 1] - y) < radius for x, y, radius in movers]
    return np.any(discs, axis=0)


@pytest.fixture(scope="module")
def scene():
    cameras = rig(perspective(), PLACES)
    return seen(cameras), cameras, masks_of(cameras, MOVERS)


def test_two_movers_have_the_points_that_whole_pictures_give_them(scene):
    pictures, cameras, masks = scene
    assert masks[:, :, 0].any(axis=1).all() and masks.mean() < 0.3
    few = stereo_points(pictures, cameras, masks, options=QUICK).position
    whole = stereo_points(pictures, cameras, options=QUICK, wanted=masks).position
    assert len(few) > MOST * len(whole)
    assert np.mean(KDTree(few).query(whole)[0] < HALF_A_STEP) > MOST
    assert np.mean(KDTree(whole).query(few)[0] < HALF_A_STEP) > MOST
    assert np.median(np.abs(few @ NORMAL - OFFSET)) < HALF_A_STEP / 4
    for x, y, radius in MOVERS:
        assert np.sum(np.hypot(few[:, 0] - x, few[:, 1] - y) < radius) > 100


def test_parts_of_any_size_give_the_same_points(scene):
    pictures, cameras, masks = scene
    few = stereo_points(pictures, cameras, masks, options=QUICK).position
    # A hundred pixels of each view, and its neighbours.
    small = replace(QUICK, part=100 * QUICK.neighbours)
    parts = stereo_points(pictures, cameras, masks, options=small).position
    assert abs(len(parts) - len(few)) < 0.01 * len(few)
    assert np.mean(KDTree(few).query(parts)[0] < SAME) > 0.98


def test_movers_of_other_sizes_need_no_other_program(scene, monkeypatch):
    pictures, cameras, masks = scene
    traced, refine = [], matching.refine

    def counted(*arguments):
        traced.append(1)
        return refine(*arguments)

    monkeypatch.setattr(matching, "refine", counted)
    # Of other options there is no program yet.
    options = replace(QUICK, noise=0.0151)
    stereo_points(pictures, cameras, masks, options=options)
    before = len(traced)
    for movers in (MOVERS[:1], ((0.2, 0.1, 0.6),)):
        stereo_points(pictures, cameras, masks_of(cameras, movers), options=options)
    assert len(traced) == before > 0


def test_nothing_that_counts_has_no_points_and_one_pixel_no_more_than_one(scene):
    pictures, cameras, masks = scene
    nothing = np.zeros_like(masks)
    assert not len(stereo_points(pictures, cameras, nothing, options=QUICK).position)
    single = nothing.copy()
    single[:, SIZE // 2, SIZE // 2] = True
    assert len(stereo_points(pictures, cameras, single, options=QUICK).position) <= len(PLACES)


def test_a_list_holds_the_pixels_that_count_row_by_row():
    counts = jnp.asarray([[False, True, False], [True, False, True]])
    pixels = pixel_list(counts, jnp.asarray(2), 2)
    assert pixels.pixel.tolist() == [1, 3, 5, 0, 0, 0]
    # Pixels that do not count have the slot of the one before; the first has none before.
    assert pixels.slot.tolist() == [[0, 0, 0], [1, 1, 2]]
    picture = jnp.arange(6.0).reshape(2, 3)
    listed = pixels.listed(picture)
    assert pixels.part(jnp.asarray(1), listed).tolist() == [5, 0]
    changed = pixels.with_part(jnp.asarray(1), listed, jnp.asarray([7.0, 8.0]))
    other = jnp.full((2, 3), -1.0)
    assert pixels.picture(changed, other).tolist() == [[-1, 1, -1], [3, -1, 7]]
