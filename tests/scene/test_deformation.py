"""A field that has learnt nothing moves nothing; one that has moves what it should."""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy
from jax.test_util import check_grads

from gaussray.geometry import normalize_quaternion
from gaussray.scene import deformation
from gaussray.scene.deformation import CONTRAST, FieldOptions, deform


# A few float32 roundings of numbers near 1.
CLOSE = {"rtol": 1e-6, "atol": 1e-6}


@pytest.fixture(scope="module")
def bodies():
    """Two Gaussians whose quaternions are not of unit length."""
    made = toy.gaussians([[-0.4, 0, 0], [0.3, 0.4, -0.1]], [0.2, 0.1], [[1, 0, 0], [0, 1, 0]])
    return eqx.tree_at(lambda g: g.quat, made, toy.single([[2, 0, 0, 0], [1, 1, 0, 1]]))


@pytest.mark.parametrize("time", [-1.0, 0.0, 0.37, 1.0, 7.0])
def test_zero_initialised_heads_are_the_identity_at_every_time(bodies, time):
    moved = toy.deformed(bodies, toy.deformation(), toy.single(time))
    np.testing.assert_allclose(moved.mean, bodies.mean, **CLOSE)
    np.testing.assert_array_equal(moved.scale, bodies.scale)
    np.testing.assert_allclose(moved.quat, normalize_quaternion(bodies.quat), **CLOSE)
    np.testing.assert_array_equal(moved.opacity, bodies.opacity)
    np.testing.assert_array_equal(moved.harmonics, bodies.harmonics)
    np.testing.assert_array_equal(moved.tint, np.ones((2, 3)))


def test_biases_of_the_heads_are_the_residuals(bodies):
    field = toy.deformation()
    where = lambda d: tuple(h[1].bias for h in (d.mean, d.rotation, d.scale, d.tint))  # noqa: E731
    shift, turn, grow, shade = (
        toy.single(x) for x in ([1, 2, 3], [0, 0, 0, 1], [0.02, 0, -0.02], [0.1, 0, -0.2])
    )
    field = eqx.tree_at(where, field, (shift, turn, grow, shade))
    moved = toy.deformed(bodies, field, toy.single(0.5))
    np.testing.assert_allclose(moved.mean, bodies.mean + shift[None], **CLOSE)
    np.testing.assert_allclose(moved.quat[0], [1, 0, 0, 1], **CLOSE)
    np.testing.assert_allclose(moved.scale, bodies.scale * jnp.exp(grow)[None], rtol=1e-3)
    np.testing.assert_allclose(moved.tint, np.tile(np.exp(shade), (2, 1)), rtol=1e-3)


def test_light_falls_on_what_faces_it_and_turns_over_with_the_body():
    field = toy.deformation()
    # The third harmonic is z: light from above, dark below.
    light = jnp.zeros((9, 3), jnp.float32).at[2].set(1.0)
    # Half a turn about x in the second half of the time.
    turn = (
        jnp.zeros_like(field.bodies.turn).at[..., 0].set(1).at[:, -1].set(toy.single([0, 1, 0, 0]))
    )
    field = eqx.tree_at(lambda d: (d.light, d.bodies.turn), field, (light, turn))
    # Discs above and below the pivot, one with its axis inwards: sides do not matter.
    discs = toy.gaussians([[0, 0, 0.5], [0, 0, -0.5]], 0.1, [[1, 1, 1]])
    strength = np.sqrt(3 / (4 * np.pi))
    first, last = (np.asarray(toy.deformed(discs, field, toy.single(t)).tint)[:, 0] for t in (0, 1))
    np.testing.assert_allclose(first, np.exp([strength, -strength]), rtol=2e-2)
    np.testing.assert_allclose(last, first[::-1], rtol=1e-5)


def test_tints_stay_within_sun_and_shade(bodies):
    field = toy.deformation()
    field = eqx.tree_at(lambda d: d.tint[1].bias, field, toy.single([1e6, -1e6, 0]))
    tint = np.asarray(toy.deformed(bodies, field, toy.single(0.5)).tint)
    np.testing.assert_allclose(np.log(tint[0]), [CONTRAST, -CONTRAST, 0], atol=1e-5)


def test_a_body_turns_its_gaussians_about_its_pivot(bodies):
    field = toy.deformation()
    # (1, 0, 0, 1) is a quarter turn about z: (x, y, z) -> (-y, x, z) about the origin.
    turn = jnp.broadcast_to(toy.single([1, 0, 0, 1]), field.bodies.turn.shape)
    path = jnp.broadcast_to(toy.single([1, 2, 3]), field.bodies.path.shape)
    field = eqx.tree_at(lambda d: (d.bodies.turn, d.bodies.path), field, (turn, path))
    moved = toy.deformed(bodies, field, toy.single(0.5))
    x, y, z = np.asarray(bodies.mean).T
    np.testing.assert_allclose(moved.mean, np.stack([1 - y, 2 + x, 3 + z], axis=1), **CLOSE)
    np.testing.assert_allclose(moved.quat[0], np.sqrt([0.5, 0, 0, 0.5]), **CLOSE)


def test_every_array_of_a_field_that_has_moved_gets_gradient(bodies):
    # With zero last layers nothing before them can learn yet: they have to leave zero first.
    field = toy.deformation()
    dice = np.random.default_rng(0)
    where = lambda d: tuple(h[1].weight for h in (d.mean, d.rotation, d.scale, d.tint))  # noqa: E731
    last = [toy.single(dice.normal(size=x.shape)) for x in where(field)]
    field = eqx.tree_at(where, field, last)

    def total(field):
        moved = toy.deformed(bodies, field, toy.single(0.3))
        place = jnp.sum(moved.mean * 2 + jnp.log(moved.scale)) + jnp.sum(jnp.sin(moved.quat))
        return place + jnp.sum(moved.tint)

    slope = eqx.filter_jit(jax.grad(total))(field)

    heads = (slope.trunk, slope.mean, slope.rotation, slope.scale, slope.tint)
    for leaf in jax.tree.leaves(heads):
        assert np.isfinite(leaf).all() and np.abs(leaf).max() > 0
    for scale in (*slope.planes.space, *slope.planes.time):
        assert (jnp.abs(scale).max(axis=(1, 2, 3)) > 0).all()


def moved_field(control=None):
    """A field in double precision, of which every number counts."""
    dice = np.random.default_rng(0)
    field = jax.tree.map(lambda x: jnp.asarray(x, float), toy.deformation(control=control))
    arrays, rest = eqx.partition(field, lambda x: eqx.is_array(x) and x.ndim > 1)
    arrays = jax.tree.map(lambda x: x + 0.3 * dice.normal(size=x.shape), arrays)
    return eqx.combine(arrays, rest)


@pytest.mark.parametrize("control", [None, toy.control_points()])
def test_derivatives_agree_with_differences(bodies, control):
    bodies = jax.tree.map(lambda x: jnp.asarray(x, float), bodies)
    field = moved_field(control)

    def state(gaussians, time, bias):
        gaussians = jax.tree.map(jnp.asarray, gaussians)
        changed = eqx.tree_at(lambda d: d.mean[1].bias, field, jnp.asarray(bias))
        moved = deform(gaussians, changed, jnp.asarray(time))
        return moved.mean, moved.quat, moved.scale, moved.tint

    check_grads(state, (bodies, 0.37, field.mean[1].bias), order=1, modes=["rev"], eps=1e-6)


def test_forward_mode_equals_reverse_mode_in_double_precision(bodies):
    field = moved_field(None)

    def middle(time):
        return jnp.sum(deform(bodies, field, time).mean)

    time = jnp.asarray(0.37)
    np.testing.assert_allclose(jax.jvp(middle, (time,), (1.0,))[1], jax.grad(middle)(time))


@pytest.mark.parametrize("control", [None, toy.control_points()])
def test_what_is_held_moves_rigidly_for_derivatives(bodies, control):
    bodies = jax.tree.map(lambda x: jnp.asarray(x, float), bodies)
    field = moved_field(control)

    def state(gaussians, *, held):
        moved = deform(gaussians, field, jnp.asarray(0.37), held=held)
        return moved.mean, moved.tint

    same = jax.tree.map(jnp.array_equal, *(state(bodies, held=held) for held in (True, False)))
    assert all(jax.tree.leaves(same))
    by_place, by_tint = jax.jacrev(functools.partial(state, held=True))(bodies)
    for i in range(2):
        turn = by_place.mean[i, :, i]
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    assert not any(np.any(x) for x in (by_place.quat, by_tint.mean, by_tint.quat))
    assert np.any(jax.jacrev(functools.partial(state, held=False))(bodies)[1].mean)


@pytest.mark.parametrize(
    ("key", "value"),
    [("sides", ()), ("sides", (1,)), ("instants", 1), ("channels", 0), ("width", 0)],
)
def test_a_size_that_cannot_be_is_named(key, value):
    with pytest.raises(ValueError, match=f"field.{key} must"):
        FieldOptions(**{key: value})


def test_a_field_of_no_scales_of_which_heads_are_left_moves_any_number_of_gaussians():
    """Pruning may leave that: the heads' biases alone. On a CPU more Gaussians than a block go
    through the network block by block."""
    field = toy.deformation()
    shift = toy.single([1, 2, 3])
    planes = dataclasses.replace(field.planes, space=(), time=())
    where = lambda d: (d.planes, d.trunk.weight, d.mean[1].bias)  # noqa: E731
    field = eqx.tree_at(where, field, (planes, field.trunk.weight[:0], shift))
    count = deformation._NETWORK_BLOCK + 3
    many = toy.gaussians(np.zeros((count, 3)), 0.1, (0.5, 0.5, 0.5))
    moved = toy.deformed(many, field, toy.single(0.5))
    np.testing.assert_allclose(moved.mean, np.tile(np.asarray(shift), (count, 1)), **CLOSE)
