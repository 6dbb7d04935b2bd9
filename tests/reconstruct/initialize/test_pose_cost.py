"""What a pose costs, by hand."""

import jax.numpy as jnp
import numpy as np
import pytest

from gaussray.reconstruct.initialize.pose_cost import (
    DOUBT,
    MISMATCH,
    UNSEEN,
    Known,
    Pose,
    Visibility,
    pose_cost,
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
