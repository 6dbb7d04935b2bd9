"""Points for what no point stands on: in every empty cell, in the pixel's colour, at a distance
like that of the points beside it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from textured_plane import PLACES, SIZE, perspective, rig, seen

from gaussray.color import srgb_encode
from gaussray.reconstruct.initialize.stereo.uncovered import (
    coverage,
    hiding,
    uncovered_points,
)
from gaussray.reconstruct.initialize.stereo.view_sets import StereoViewSet
from gaussray.reconstruct.initialize.stereo.views import seen_at, stereo_views


CELL = 8
# A bilinear place and a rounded colour, of 1.
CLOSE = 0.02


def pictures_of_plane(views=3):
    cameras = rig(perspective(), PLACES[:views])
    return StereoViewSet(np.asarray(seen(cameras)), None, cameras, np.arange(views))


def cells_with_points(shown, position):
    """How many points lie in each cell of each view's picture."""
    views = stereo_views(shown.pictures, shown.cameras, None, factor=1)
    x, y, inside = (np.asarray(v) for v in seen_at(views, jnp.asarray(position.T)))
    counts = np.zeros((len(shown.frames), SIZE // CELL, SIZE // CELL), int)
    for k in range(len(shown.frames)):
        at = (y[k][inside[k]] // CELL).astype(int), (x[k][inside[k]] // CELL).astype(int)
        np.add.at(counts[k], at, 1)
    return counts


def added_to(shown, position, plain=None):
    count = len(shown.frames) * (SIZE // CELL) ** 2
    return uncovered_points(shown, position, count=count, seed=0, plain=plain)


def on_plane(count):
    """Random places on the left half of what the cameras see of the plane z = 0, about."""
    dice = np.random.default_rng(0)
    return np.stack(
        [dice.uniform(-1.4, 0, count), dice.uniform(-1.4, 1.4, count), np.zeros(count)], axis=1
    ).astype(np.float32)


def test_afterwards_every_cell_holds_a_point():
    shown, position = pictures_of_plane(), on_plane(400)
    before = cells_with_points(shown, position)
    more = added_to(shown, position).position
    after = cells_with_points(shown, np.concatenate([position, more]))
    assert (before == 0).sum() > 20 and (after[:, 1:-1, 1:-1] > 0).all()
    # Points of one view serve the next.
    assert len(more) < (before == 0).sum()


def test_points_have_the_colour_of_their_pixel_and_the_distance_of_those_beside_them():
    shown, position = pictures_of_plane(1), on_plane(400)
    found = added_to(shown, position)
    origin = np.asarray(shown.cameras.trajectory.translation)[0, 0]
    distance = np.linalg.norm(found.position - origin, axis=1)
    known = np.linalg.norm(position - origin, axis=1)
    assert distance.min() > 0.8 * known.min() and distance.max() < 1.25 * known.max()
    views = stereo_views(shown.pictures, shown.cameras, None, factor=1)
    x, y, _ = (np.asarray(v)[0] for v in seen_at(views, jnp.asarray(found.position.T)))
    # Their pixels' centres, but for those at the border, which have no room for four pixels.
    inner = (x > 1) & (x < SIZE - 1) & (y > 1) & (y < SIZE - 1)
    pixel = shown.pictures[0][(y[inner]).astype(int), x[inner].astype(int)]
    np.testing.assert_allclose(srgb_encode(found.color[inner]), pixel, atol=CLOSE)


def test_masked_pixels_get_no_points():
    shown = pictures_of_plane(1)
    mask = np.ones((1, SIZE, SIZE), bool)
    mask[:, :, SIZE // 2 :] = False
    found = added_to(shown._replace(masks=mask), np.zeros((0, 3), np.float32))
    views = stereo_views(shown.pictures, shown.cameras, None, factor=1)
    x, _, inside = (np.asarray(v)[0] for v in seen_at(views, jnp.asarray(found.position.T)))
    assert len(found.position) > 0 and x[inside].max() <= SIZE / 2


def test_nothing_is_added_where_all_is_covered():
    shown = pictures_of_plane(1)
    whole = added_to(shown, np.zeros((0, 3), np.float32)).position
    assert len(whole) == (SIZE // CELL) ** 2
    assert len(added_to(shown, jax.device_get(whole)).position) < 0.2 * len(whole)


def covered_by(shown, position, plain=None):
    return coverage(shown, position, count=len(shown.frames) * (SIZE // CELL) ** 2, plain=plain)


def test_coverage_is_the_share_of_cells_that_hold_a_point():
    shown = pictures_of_plane()
    for count in (20, 400):
        held = cells_with_points(shown, on_plane(count)) > 0
        assert covered_by(shown, on_plane(count)) == held.mean()
    # More points of one half do not cover the other.
    assert covered_by(shown, on_plane(20_000)) < 0.7
    assert covered_by(shown, np.zeros((0, 3), np.float32)) == 0


def test_what_is_masked_need_not_be_covered():
    shown = pictures_of_plane(1)
    x = np.flatnonzero((cells_with_points(shown, on_plane(4000)) > 0).all(axis=(0, 1)))
    mask = np.zeros((1, SIZE, SIZE), bool)
    mask[:, :, x.min() * CELL : (x.max() + 1) * CELL] = True
    assert covered_by(shown, on_plane(4000)) < 0.7
    assert covered_by(shown._replace(masks=mask), on_plane(4000)) == 1
    assert covered_by(shown._replace(masks=mask & False), on_plane(4000)) == 1


def before_a_backdrop(color):
    """Pictures of the plane's middle before a plain backdrop, and points on the plane."""
    shown = pictures_of_plane()
    pictures = np.broadcast_to(np.float32(color), shown.pictures.shape).copy()
    middle = slice(SIZE // 3, 2 * SIZE // 3)
    pictures[:, middle, middle] = shown.pictures[:, middle, middle]
    return shown._replace(pictures=pictures), on_plane(400)


@pytest.mark.parametrize("color", [(0.0, 0.0, 0.0), (0.9, 0.8, 0.7)])
def test_before_a_backdrop_nothing_is_put_into_the_air(color):
    shown, position = before_a_backdrop(color)
    found = added_to(shown, position, color)
    assert 0 < len(found.position) < len(added_to(shown, position).position)
    assert np.abs(srgb_encode(found.color) - np.array(color)).max(axis=1).min() > 0.5 * CLOSE


@pytest.mark.parametrize("color", [(0.0, 0.0, 0.0), (0.9, 0.8, 0.7)])
def test_a_backdrop_need_not_be_covered(color):
    shown, _ = before_a_backdrop(color)
    dice = np.random.default_rng(1)
    middle = np.column_stack([dice.uniform(-0.6, 0.6, (4000, 2)), np.zeros(4000)])
    middle = middle.astype(np.float32)
    assert covered_by(pictures_of_plane(), middle) < 0.5
    assert covered_by(shown, middle, color) > 0.9


@pytest.mark.parametrize(
    ("along", "size", "hides"),
    [
        (0.5, 0.01, True),  # before the plane
        (1.5, 0.01, False),  # behind it
        (1.5, 1.0, True),  # behind it, and reaching before it
        (-0.5, 0.01, False),  # behind the camera
        (-0.5, 1.0, True),  # around the camera
    ],
)
def test_a_ball_hides_what_pictures_show_if_any_of_it_is_nearer(along, size, hides):
    shown, position = pictures_of_plane(), on_plane(400)
    origin = np.asarray(shown.cameras.trajectory.translation)[0, 0]
    middle = position[[np.argmin(np.abs(position).sum(axis=1))]]
    more = (origin + along * (middle - origin)).astype(np.float32)
    found = hiding(shown, position, more, np.array([size]), count=3 * (SIZE // CELL) ** 2)
    assert found.tolist() == [hides]


def test_where_pictures_show_no_point_nothing_is_hidden():
    shown = pictures_of_plane()
    more = np.array([[0.0, 0.0, 0.1]], np.float32)
    nothing = np.zeros((0, 3), np.float32)
    assert not hiding(shown, nothing, more, np.array([0.01]), count=100).any()
