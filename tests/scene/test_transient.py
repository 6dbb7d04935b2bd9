"""Transient Gaussians: their path, their window, and their place in a scene."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy
from jax.test_util import check_grads

from gaussray.scene.point_tracks import FREE, carried, group_of
from gaussray.scene.scene import Scene, at, key_count, transient_count
from gaussray.scene.transient import (
    Transients,
    constrain_transients,
    squared_age,
    transients_at,
    unconstrain_transients,
)


pytestmark = pytest.mark.usefixtures("quick_compilation")

# Rounding of single precision, after a logarithm and an exponential.
ROUNDING = 1e-5


def crowd(count=5, seed=0):
    """Random transient Gaussians about times in [0, 1]."""
    dice = np.random.default_rng(seed)
    parts = {
        "mean": dice.normal(size=(count, 3)),
        "velocity": dice.normal(size=(count, 3)),
        "quat": dice.normal(size=(count, 4)),
        "scale": dice.uniform(0.01, 0.2, (count, 3)),
        "opacity": dice.uniform(0.1, 0.9, count),
        "harmonics": dice.normal(size=(count, 1, 3)),
        "instant": dice.uniform(0, 1, count),
        "lifetime": dice.uniform(0.05, 0.2, count),
        "plateau": dice.uniform(0, 0.1, count) * (np.arange(count) % 2),
    }
    return Transients(**{k: toy.single(v) for k, v in parts.items()})


def scene():
    """What stands still, what moves, and what is there for a short time."""
    return replace(toy.scene(), transient=crowd())


def test_the_window_is_flat_and_then_a_gaussian():
    age = toy.single([-0.5, -0.3, -0.2, 0.0, 0.2, 0.4])
    s = squared_age(age, toy.single(1 / 0.1), toy.single(0.2))
    np.testing.assert_allclose(s, [9, 1, 0, 0, 0, 4], atol=ROUNDING)


def test_gaussians_are_displaced_by_their_velocity_and_dimmed_by_their_window():
    one = crowd(1)
    now = transients_at(one, one.instant[0] + 0.1)
    np.testing.assert_allclose(now.mean, one.mean + 0.1 * one.velocity, rtol=ROUNDING)
    window = np.exp(-0.5 * (0.1 / one.lifetime) ** 2)
    np.testing.assert_allclose(now.opacity, one.opacity * window, rtol=ROUNDING)


def test_the_derivative_of_the_window_is_that_of_finite_differences():
    x = jax.tree.map(lambda x: jnp.asarray(x, jnp.float64), crowd())
    names = ("instant", "lifetime", "velocity", "plateau")

    def seen(values, time):
        parts = dict(zip(names, map(jnp.asarray, values), strict=True))
        now = transients_at(replace(x, **parts), jnp.asarray(time))
        return now.mean, now.opacity

    values = tuple(getattr(x, name) for name in names)
    check_grads(seen, (values, jnp.asarray(0.6)), order=1, modes=["fwd", "rev"], eps=1e-6)


def test_unconstrained_values_are_the_same_gaussians_and_keep_the_floor_of_the_lifetime():
    x, shortest = crowd(), 0.02
    again = constrain_transients(unconstrain_transients(x, shortest), shortest)
    for a, b in zip(jax.tree.leaves(again), jax.tree.leaves(x), strict=True):
        np.testing.assert_allclose(a, b, rtol=ROUNDING)
    brief = replace(x, lifetime=jnp.full(5, 0.001))
    assert (constrain_transients(unconstrain_transients(brief, 0.02), 0.02).lifetime > 0.02).all()


def test_a_scene_at_a_time_holds_them_last():
    whole, time = scene(), toy.single(0.4)
    persistent, expected = at(toy.scene(), time), transients_at(whole.transient, time)
    found = at(whole, time)
    assert found.count == whole.count == persistent.count + transient_count(whole)
    first = persistent.count
    np.testing.assert_array_equal(found.mean[:first], persistent.mean)
    np.testing.assert_array_equal(found.mean[first:], expected.mean)
    np.testing.assert_array_equal(found.opacity[first:], expected.opacity)


def test_beyond_the_clip_they_rest():
    whole = scene()
    for inside, outside in ((0.0, -5.0), (1.0, 9.0)):
        near, far = (at(whole, toy.single(t)) for t in (inside, outside))
        for a, b in zip(jax.tree.leaves(near), jax.tree.leaves(far), strict=True):
            np.testing.assert_array_equal(a, b)


def test_they_ask_for_no_key_states():
    still = toy.scene(speed=0)
    assert key_count(replace(still, transient=crowd()), 1.0) == 1


def test_a_point_on_one_travels_at_its_velocity_and_belongs_to_what_moves():
    whole, time = scene(), toy.single(0.4)
    first = whole.static.count + whole.moving.count
    point = toy.single([1.0, 2.0, 3.0])
    for part in (whole, Scene(whole.static, whole.moving, None, whole.time_range, crowd())):
        path = carried(part, jnp.asarray(first + 2), point, time)
        expected = point + 0.3 * whole.transient.velocity[2]
        np.testing.assert_allclose(path(toy.single(0.7)), expected, rtol=ROUNDING)
    still = carried(whole, jnp.asarray(0), point, time)
    np.testing.assert_array_equal(still(toy.single(0.7)), point)
    groups = np.asarray(group_of(whole))
    assert len(groups) == whole.count and (groups[first:] == FREE).all()
