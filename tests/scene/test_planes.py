"""Six planes: what stands at a knot is what is read there, and between knots all is linear."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from gaussray.scene import planes as field
from gaussray.scene.planes import SPACE_PAIRS, Planes, initial_planes


# Products of six float64 samples.
CLOSE = {"rtol": 1e-12, "atol": 1e-14}
LOWER, UPPER = np.array([-1.0, 0.0, 2.0]), np.array([1.0, 3.0, 2.5])
BEGIN, END = 10.0, 14.0

features = jax.jit(field.features)


@pytest.fixture(scope="module")
def planes():
    """Random planes of two scales, 3 instants."""
    start = initial_planes(
        jax.random.key(0), jnp.asarray(LOWER), jnp.asarray(UPPER), (BEGIN, END),
        sides=(3, 5), instants=3, channels=2,
    )  # fmt: skip
    dice = np.random.default_rng(1)
    noise = lambda x: jnp.asarray(dice.uniform(0.5, 1.5, x.shape))  # noqa: E731
    return eqx.tree_at(lambda p: (p.space, p.time), start,
                       (tuple(map(noise, start.space)), tuple(map(noise, start.time))))  # fmt: skip


def by_hand(planes: Planes, position, time):
    """Six bilinear samples in numpy, one position."""

    def line(count, x):
        weight = np.zeros(count)
        place = np.clip(x, 0, 1) * (count - 1)
        low = min(int(place), count - 2)
        weight[low], weight[low + 1] = 1 - (place - low), place - low
        return weight

    unit = (position - LOWER) / (UPPER - LOWER)
    moment = (time - BEGIN) / (END - BEGIN)
    parts = []
    for space, instants in zip(planes.space, planes.time, strict=True):
        product = np.ones(space.shape[-1])
        for plane, (a, b) in zip(np.asarray(space), SPACE_PAIRS, strict=True):
            side = plane.shape[0]
            product *= np.einsum("y,x,yxc->c", line(side, unit[b]), line(side, unit[a]), plane)
        for plane, x in zip(np.asarray(instants), unit, strict=True):
            rows, side, _ = plane.shape
            product *= np.einsum("t,x,txc->c", line(rows, moment), line(side, x), plane)
        parts.append(product)
    return np.concatenate(parts)


def test_at_a_knot_the_features_are_the_products_of_what_stands_there(planes):
    position = jnp.asarray(LOWER + (UPPER - LOWER) * np.array([0.5, 1.0, 0.0]))[None]
    found = features(planes, position, jnp.asarray(12.0))[0]
    for s, (space, time) in enumerate(zip(planes.space, planes.time, strict=True)):
        x, y, z = (space.shape[1] - 1) // 2, space.shape[1] - 1, 0
        expected = space[0][y, x] * space[1][z, x] * space[2][z, y]
        expected *= time[0][1, x] * time[1][1, y] * time[2][1, z]
        np.testing.assert_allclose(found[2 * s : 2 * s + 2], expected, **CLOSE)


def test_features_equal_numpy_anywhere(planes):
    dice = np.random.default_rng(2)
    position = dice.uniform(LOWER, UPPER, (20, 3))
    for time in (10.0, 11.3, 14.0):
        found = features(planes, jnp.asarray(position), jnp.asarray(time))
        expected = [by_hand(planes, p, time) for p in position]
        np.testing.assert_allclose(found, expected, **CLOSE)


def test_beyond_the_box_and_the_clip_the_border_holds(planes):
    inside = jnp.asarray([LOWER, UPPER])
    outside = jnp.asarray([LOWER - 5, UPPER + 5])
    for near, far in ((BEGIN, BEGIN - 3), (END, END + 100)):
        found = features(planes, outside, jnp.asarray(far))
        np.testing.assert_array_equal(found, features(planes, inside, jnp.asarray(near)))


def test_derivatives_to_place_time_and_planes(planes):
    position = jnp.asarray(np.random.default_rng(3).uniform(LOWER, UPPER, (4, 3)))

    def total(position, time, space, instants):
        changed = eqx.tree_at(lambda p: (p.space, p.time), planes, (space, instants))
        return jnp.sum(jnp.sin(features(changed, jnp.asarray(position), jnp.asarray(time))))

    arguments = (position, jnp.asarray(11.3), planes.space, planes.time)
    check_grads(jax.jit(total), arguments, order=1, modes=["rev"], atol=1e-6, rtol=1e-6)


def test_every_plane_gets_gradient(planes):
    position = jnp.asarray(np.random.default_rng(4).uniform(LOWER, UPPER, (30, 3)))
    total = lambda p: jnp.sum(features(p, position, jnp.asarray(11.3)))  # noqa: E731
    slope = jax.jit(jax.grad(total))(planes)
    for scale in (*slope.space, *slope.time):
        assert (jnp.abs(scale).max(axis=(1, 2, 3)) > 0).all()


def test_a_new_field_is_the_same_at_all_times():
    start = initial_planes(
        jax.random.key(0), jnp.asarray(LOWER), jnp.asarray(UPPER), (BEGIN, END),
        sides=(3,), instants=4, channels=2,
    )  # fmt: skip
    assert start.width == 2
    position = jnp.asarray([[0.3, 1.1, 2.2]])
    first, last = (features(start, position, jnp.asarray(t)) for t in (10.0, 13.1))
    np.testing.assert_allclose(first, last, **CLOSE)


def test_a_clip_of_one_instant_has_the_field_of_a_clip_that_begins_there(planes):
    one, two = (eqx.tree_at(lambda p: p.end, planes, jnp.asarray(BEGIN + x)) for x in (0.0, 1.0))
    place, time = jnp.asarray([[0.0, 1.0, 2.1]]), jnp.asarray(BEGIN)
    total = jax.jit(jax.value_and_grad(lambda p, t: jnp.sum(features(p, place, t)), argnums=1))
    np.testing.assert_allclose(total(one, time), total(two, time), **CLOSE)
    expected = by_hand(two, np.asarray(place[0]), BEGIN)
    np.testing.assert_allclose(features(one, place, time)[0], expected, **CLOSE)


def test_a_box_without_extent_is_read_at_its_border(planes):
    flat = eqx.tree_at(lambda p: p.upper, planes, planes.lower)
    place = jnp.asarray([LOWER])
    slope = jax.jit(jax.jacrev(lambda p: features(flat, p, jnp.asarray(BEGIN))))(place)
    found = features(flat, place, jnp.asarray(BEGIN))
    np.testing.assert_allclose(found, features(planes, place, jnp.asarray(BEGIN)))
    # Its size is 1 instead of 0; before it there is nothing but its border.
    whole = eqx.tree_at(lambda p: p.upper, planes, planes.lower + 1)
    expected = jax.jacrev(lambda p: features(whole, p, jnp.asarray(BEGIN)))(place)
    np.testing.assert_allclose(slope, expected, **CLOSE)
    before = jax.jacrev(lambda p: features(flat, p, jnp.asarray(BEGIN)))(place - 0.1)
    np.testing.assert_array_equal(before, 0)
