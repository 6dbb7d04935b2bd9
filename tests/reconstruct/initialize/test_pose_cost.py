"""What a pose costs, by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy
from scipy.spatial.transform import Rotation

from gaussray.reconstruct.initialize.pose_cost import (
    DOUBT,
    MISMATCH,
    UNSEEN,
    Known,
    Pictures,
    Pose,
    Visibility,
    mismatch_at,
    pose_cost,
    toward_views,
)


VIEWS, POINTS = 2, 4
ORIGIN = Pose(jnp.zeros(3), jnp.array([1.0, 0, 0, 0]))
STAY = jnp.zeros(6)


def cost(facing=1.0, light=0.0, seen=True, covers=False, change=STAY):
    """Black points of a body that faces +z, in pictures of one grey."""
    normal = jnp.tile(jnp.array([0.0, 0, 1]), (POINTS, 1))
    place = jnp.zeros((POINTS, 3))
    own = Known(place, normal, jnp.zeros((POINTS, 5)), jnp.zeros(3), jnp.array(1.0))
    each = (VIEWS, POINTS)
    visible = Visibility(
        place,
        normal,
        jnp.zeros((*each, 3)).at[..., 2].set(facing),
        jnp.ones((*each, 2)),
        jnp.zeros((*each, 2, 3)),
        jnp.full(each, seen),
        jnp.full(each, covers),
    )
    return float(pose_cost(change, ORIGIN, own, visible, jnp.full((VIEWS, 3, 3, 5), light)))


@pytest.mark.parametrize(("light", "difference"), [(0.0, 0.0), (0.03, 0.05), (9.0, MISMATCH)])
def test_a_pose_costs_the_difference_of_what_is_seen(light, difference):
    expected = (difference + DOUBT * UNSEEN) / (1 + DOUBT)
    assert cost(light=light) == pytest.approx(expected)


def test_what_is_hidden_says_little():
    assert cost(light=9.0, seen=False) == pytest.approx(UNSEEN)


def test_a_body_that_was_found_is_covered_by_no_other():
    assert cost(covers=True) == pytest.approx((MISMATCH + DOUBT * UNSEEN) / (1 + DOUBT))


def test_a_turn_shows_other_sides():
    half = jnp.zeros(6).at[0].set(np.pi)
    assert cost(facing=-1.0, light=0.03, change=half) == pytest.approx(cost(light=0.03))


def test_a_pose_that_faces_no_view_is_none():
    assert cost(facing=-1.0) == pytest.approx(MISMATCH)


SIDE = 24


def pictures(light=None):
    """What five cameras before the origin show: one colour everywhere, or any in each pixel."""
    cameras = [toy.camera(angle, 0.0, SIDE, SIDE) for angle in np.linspace(-0.8, 0.8, 5)]
    views = jax.tree.map(lambda *x: jnp.stack(x), *cameras)
    layer = np.random.default_rng(0).uniform(0, 0.2, (5, SIDE, SIDE, 5))
    return Pictures(views, [jnp.asarray(layer if light is None else 0 * layer + light)], 1)


def two_bodies(count=40):
    """Points about two places, with normals that point away from them."""
    dice = np.random.default_rng(1)
    normal = dice.normal(size=(2, count, 3))
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    pivot = np.array([[0.2, 0, 0], [-0.3, 0.1, 0.2]])
    look = dice.uniform(0, 0.2, size=(2, count, 5))
    parts = map(jnp.asarray, (pivot[:, None] + 0.2 * normal, normal, look, pivot))
    return Known(*parts, jnp.full(2, 0.1))


def test_parts_of_one_body_are_explained_by_the_motion_of_each():
    known, turn = two_bodies(), Rotation.from_rotvec([0.3, -0.5, 0.2])
    # Both turn about the origin, then move.
    pivot = np.array(known.pivot)
    path = turn.apply(pivot) - pivot + [0.1, 0.2, -0.1]
    pose = Pose(jnp.asarray(path), jnp.tile(jnp.asarray(turn.as_quat()[[3, 0, 1, 2]]), (2, 1)))
    found = mismatch_at(pose, known, pictures())
    np.testing.assert_allclose(found.others, np.tile(found.moved, (2, 1)), rtol=1e-9)
    otherwise = mismatch_at(pose._replace(path=pose.path.at[0, 0].add(0.4)), known, pictures())
    assert abs(otherwise.others[0, 1] / found.moved[1] - 1) > 0.01
    still = Pose(jnp.zeros((2, 3)), jnp.zeros((2, 4)).at[:, 0].set(1))
    found = mismatch_at(still, known, pictures())
    np.testing.assert_allclose(found.moved, found.rests, rtol=1e-9)


@pytest.mark.parametrize(("light", "turned"), [(0.05, True), (0.2, False)])
def test_points_that_face_no_view_are_turned_to_those_that_show_them(light, turned):
    known = two_bodies()
    known = known._replace(look=jnp.full_like(known.look, 0.05))
    sight = np.array([0, 0, -1.0])
    found = np.asarray(toward_views(known, pictures(light)).normal)
    was = np.asarray(known.normal)
    away = was @ sight < -0.9
    assert away.any()
    np.testing.assert_array_equal(found[away], -was[away] if turned else was[away])
    towards = was @ sight > 0.5
    np.testing.assert_array_equal(found[towards], was[towards])
