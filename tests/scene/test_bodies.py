"""Rigid bodies: who belongs to them, and where they are."""

import jax
import jax.numpy as jnp
import numpy as np
from jax.test_util import check_grads

from gaussray.geometry import rotation_matrix
from gaussray.scene.bodies import bodies_at_rest, body_of, body_pose_at, extrapolate_bodies


# Rounding of float64 sums of a few terms.
EXACT = 1e-12
TIMES = jnp.asarray([0.0, 0.2, 0.5, 1.0])


def thrown():
    """Two bodies; the first on a parabola, sampled at even instants."""
    times = jnp.linspace(0.0, 1.0, 5)
    body = bodies_at_rest(jnp.asarray([[0.0, 0, 0], [5, 0, 0]]), jnp.asarray([1.0, 2.0]), times)
    path = jnp.stack([times, 2 * times - 4 * times**2, jnp.zeros(5)], axis=-1)
    return body.__class__(body.pivot, body.radius, times, body.path.at[0].set(path), body.turn)


def test_a_resting_body_is_the_identity_at_all_times():
    body = bodies_at_rest(jnp.ones((2, 3)), jnp.ones(2), TIMES)
    for time in (-1.0, 0.0, 0.3, 2.0):
        path, turn = body_pose_at(body, jnp.asarray(time))
        assert np.abs(path).max() == 0
        assert np.allclose(rotation_matrix(turn), np.eye(3), atol=EXACT)


def test_poses_are_met_at_their_instants_and_rest_beyond():
    body = thrown()
    for i, time in enumerate(body.time):
        assert np.allclose(body_pose_at(body, time)[0], body.path[:, i], atol=EXACT)
    assert np.allclose(body_pose_at(body, jnp.asarray(9.0))[0], body.path[:, -1], atol=EXACT)


def test_a_parabola_is_followed_exactly_between_inner_instants():
    time = jnp.asarray(0.4)
    path, _ = body_pose_at(thrown(), time)
    assert np.allclose(path[0], [0.4, 0.8 - 4 * 0.16, 0], atol=EXACT)


def test_a_parabola_is_followed_exactly_between_uneven_instants():
    times = jnp.asarray([0.0, 0.1, 0.4, 0.5, 0.7])
    body = bodies_at_rest(jnp.zeros((1, 3)), jnp.ones(1), times)
    path = jnp.stack([times, 2 * times - 4 * times**2, jnp.zeros(5)], axis=-1)
    body = body.__class__(body.pivot, body.radius, times, path[None], body.turn)
    for time in np.linspace(0.1, 0.5, 9):
        place = body_pose_at(body, jnp.asarray(time))[0][0]
        assert np.allclose(place, [time, 2 * time - 4 * time**2, 0], atol=EXACT)


def test_bodies_that_reach_further_go_on_at_steady_speed():
    body = thrown()
    further = extrapolate_bodies(body, 0.1, 0.2)
    assert np.allclose(further.time, [-0.1, *body.time, 1.2], atol=EXACT)
    # The first and the last quarter's speeds are (1, 1) and (1, -5).
    for time, place in ((-0.1, [-0.1, -0.1, 0]), (1.2, [1.2, -2 - 1, 0])):
        path, turn = body_pose_at(further, jnp.asarray(time))
        assert np.allclose(path, [place, [0, 0, 0]], atol=EXACT)
        assert np.allclose(rotation_matrix(turn), np.eye(3), atol=EXACT)
    assert np.allclose(further.path[:, 1:-1], body.path, atol=EXACT)
    same = extrapolate_bodies(body, 0.0, 0.0)
    assert np.array_equal(same.time, body.time) and np.array_equal(same.path, body.path)


def test_gaussians_belong_to_the_nearest_body_in_reach():
    place = jnp.asarray([[0.5, 0, 0], [4, 0, 0], [0, 1.5, 0], [50, 0, 0]])
    assert body_of(thrown(), place).tolist() == [0, 1, 2, 2]


def test_without_bodies_everything_is_its_own():
    none = bodies_at_rest(jnp.zeros((0, 3)), jnp.zeros(0), TIMES)
    assert body_of(none, jnp.ones((2, 3))).tolist() == [0, 0]
    path, turn = body_pose_at(none, jnp.asarray(0.3))
    assert path.shape == (0, 3) and turn.shape == (0, 4)


def test_gradients_reach_poses_and_time():
    body = thrown()

    def place(path, turn, time):
        path, turn, time = (jnp.asarray(x) for x in (path, turn, time))
        moved = body.__class__(body.pivot, body.radius, body.time, path, turn)
        return jnp.concatenate([x.reshape(-1) for x in body_pose_at(moved, time)])

    turn = body.turn + 0.1 * jax.random.normal(jax.random.key(0), body.turn.shape)
    check_grads(place, (body.path, turn, jnp.asarray(0.37)), order=1, modes=["rev"])
