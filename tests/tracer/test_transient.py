"""Transient Gaussians along rays: exact at every ray's time, free where they do not live."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
from jax.test_util import check_grads
from scenes import (
    CAPACITY,
    COUNT,
    OPTIONS,
    RAYS,
    Lines,
    against_brute_force,
    beside,
    cast,
    fleeting,
    gaussians,
    look,
    moving,
    natural,
    pull,
    pull_dense,
    rays,
    relative_errors,
    resting,
    shot,
    stacked,
    wandering,
    weights,
)

from gaussray.scene.transient import Transients
from gaussray.tracer.dominant import dominant
from gaussray.tracer.motion import Motion
from gaussray.tracer.trace import measure, prepare, span_of


# Of single precision: mean absolute colour, and gradients relative to the largest.
COLOR, GRADIENT = 1e-5, 1e-3
# Of double precision: sums of the same numbers in another order.
DOUBLE = 1e-10
# The same numbers in single precision, in another order.
SAME = 1e-6
ROOM = replace(CAPACITY, cells=(32, 512), pairs=4096, slots=128, transient=COUNT)


def scene(keys=1, dtype=np.float64, time_range=None):
    """Transient Gaussians beside others that stand still or wander."""
    kind = {"size": (0.05, 0.4)}
    if keys == 1:
        motion = resting(gaussians(COUNT, **kind), dtype)
    else:
        motion = wandering(*moving(COUNT, keys, amount=0.05, **kind), dtype)
    return beside(motion, fleeting(COUNT, seed=3, **kind), time_range)


def alone(transients, dtype=np.float64):
    """Transient Gaussians and nothing else that is seen."""
    nothing = resting(gaussians(1), dtype)
    nothing = eqx.tree_at(lambda m: m.gaussians.opacity, nothing, jnp.zeros(1, dtype))
    return beside(nothing, transients)


def one_transient(**change):
    """A ball at (0, 0, 3) at the time 0.5 that goes to +x."""
    parts = {
        "mean": [[0, 0, 3]],
        "velocity": [[1, 0, 0]],
        "quat": [[1, 0, 0, 0]],
        "scale": [[0.2] * 3],
        "opacity": [0.8],
        "harmonics": [[[0.5, 0, -0.5]]],
        "instant": [0.5],
        "lifetime": [0.1],
        "plateau": [0.05],
    } | change
    return Transients(**{k: jnp.asarray(v, float) for k, v in parts.items()})


def one_ray(x, time):
    """A ray along +z at a place and a time."""
    return shot(Lines(np.array([[x, 0, 0]]), np.array([[0, 0, 1.0]]), np.array([time])), np.float64)


@pytest.mark.parametrize(
    ("time", "x", "alpha"),
    [
        (0.5, 0.0, 0.8),
        (0.54, 0.04, 0.8),
        (0.7, 0.2, 0.8 * np.exp(-0.5 * 1.5**2)),
        (0.7, 0.4, 0.8 * np.exp(-0.5 * (1.5**2 + 1))),
        (0.35, -0.15, 0.8 * np.exp(-0.5)),
        # s = 3.5: below 1/255.
        (0.9, 0.4, 0.0),
    ],
)
def test_a_ball_is_where_and_as_opaque_as_its_path_and_window_say(time, x, alpha):
    pixels, report = look(alone(one_transient()), one_ray(x, time), options=OPTIONS, capacity=ROOM)
    assert int(report.dropped) == 0
    np.testing.assert_allclose(1 - pixels.transmittance, alpha, atol=DOUBLE)
    np.testing.assert_allclose(pixels.depth, 3 * alpha, atol=DOUBLE)


def test_a_window_without_plateau_is_a_gaussian():
    ball = one_transient(plateau=[0.0])
    for age in (0.05, 0.1, 0.2):
        pixels, _ = look(alone(ball), one_ray(age, 0.5 + age), options=OPTIONS, capacity=ROOM)
        alpha = 0.8 * np.exp(-0.5 * (age / 0.1) ** 2)
        np.testing.assert_allclose(1 - pixels.transmittance, alpha, atol=DOUBLE)


@pytest.mark.parametrize("keys", [1, 3])
@pytest.mark.parametrize("time_range", [None, (0.3, 0.6)])
def test_pictures_are_those_of_all_gaussians_on_every_ray(keys, time_range):
    motion, lines = scene(keys, time_range=time_range), shot(rays(), np.float64)
    pixels, report = look(motion, lines, options=OPTIONS, capacity=ROOM)
    assert int(report.dropped) == 0 and int(report.hits) > 4 * RAYS
    np.testing.assert_allclose(
        stacked(pixels), stacked(reference.trace(motion, lines)), atol=DOUBLE
    )


@pytest.mark.parametrize("keys", [1, 3])
def test_gradients_are_those_of_all_gaussians_on_every_ray(keys):
    motion, lines, weight = scene(keys), shot(rays(), np.float64), weights()
    _, _, gradient = pull(motion, lines, weight, options=OPTIONS, capacity=ROOM)
    expected = pull_dense(motion, lines, weight)
    errors = relative_errors(natural(gradient, motion), natural(expected, motion))
    assert {"transient instant", "transient lifetime", "transient plateau"} <= set(errors)
    assert max(errors.values()) < 1e-7, errors


def test_single_precision_sees_and_learns_the_same():
    motion = scene(dtype=np.float32)
    color, errors, _ = against_brute_force(motion, rays(), capacity=ROOM)
    assert color < COLOR and max(errors.values()) < GRADIENT, errors


def test_finite_differences_agree_in_all_that_makes_a_window():
    transients = fleeting(8, seed=5, size=(0.2, 0.5), lifetime=(0.2, 0.4))
    motion, lines = alone(transients), shot(rays(16), np.float64)
    names = ("instant", "lifetime", "velocity", "plateau", "mean", "opacity")
    # No cut-off: a ray that meets one more Gaussian sees a step.
    options = replace(OPTIONS, alpha_min=1e-12, k=8)

    @jax.jit
    def seen(values, time):
        parts = dict(zip(names, values, strict=True))
        own = replace(motion, transient=replace(transients, **parts))
        pixels, _ = look(own, replace(lines, time=time), options=options, capacity=ROOM)
        return pixels.color, pixels.depth

    values = tuple(getattr(transients, name) for name in names)
    # Away from where a plateau begins: the second derivative is not continuous there.
    check_grads(seen, (values, lines.time), order=1, modes=["rev"], rtol=1e-3, atol=1e-4, eps=1e-6)


def test_shifting_the_time_of_scene_and_rays_changes_nothing():
    motion, lines = scene(3, time_range=(0.1, 0.9)), shot(rays(), np.float64)
    first, _ = look(motion, lines, options=OPTIONS, capacity=ROOM)
    later = Motion(
        motion.time + 3,
        motion.gaussians,
        None,
        replace(motion.transient, instant=motion.transient.instant + 3),
        motion.time_range + 3,
    )
    shifted = replace(lines, time=lines.time + 3)
    second, _ = look(later, shifted, options=OPTIONS, capacity=ROOM)
    np.testing.assert_allclose(stacked(first), stacked(second), atol=DOUBLE)


def test_an_infinite_life_at_rest_is_a_static_gaussian():
    crowd = cast(gaussians(COUNT, size=(0.05, 0.4)), np.float64)
    lines = shot(rays(), np.float64)
    expected, _ = look(resting(crowd, np.float64), lines, options=OPTIONS, capacity=ROOM)
    zero = jnp.zeros(COUNT)
    eternal = Transients(
        crowd.mean, 0 * crowd.mean, *crowd[1:], instant=zero, lifetime=zero + jnp.inf, plateau=zero
    )
    pixels, report = look(alone(eternal), lines, options=OPTIONS, capacity=ROOM)
    assert int(report.skipped) == 0
    np.testing.assert_allclose(stacked(pixels), stacked(expected), atol=DOUBLE)


def test_a_rolling_shutter_sees_in_every_row_what_an_instant_sees_there():
    motion, lines = scene(dtype=np.float32), shot(rays())
    rows = np.arange(RAYS) // 16 / 4
    rolled = replace(lines, time=jnp.asarray(rows, jnp.float32))
    together, _ = look(motion, rolled, options=OPTIONS, capacity=ROOM)
    for row in range(4):
        instant = replace(lines, time=jnp.full(RAYS, row / 4, jnp.float32))
        frozen, _ = look(motion, instant, options=OPTIONS, capacity=ROOM)
        mine = rows == row / 4
        np.testing.assert_allclose(stacked(together)[mine], stacked(frozen)[mine], atol=SAME)


def test_samples_share_lists_and_see_what_each_would_see_alone():
    motion, lines = scene(3, dtype=np.float32), shot(rays())
    several = jax.tree.map(lambda x: jnp.stack([x, x]), lines)
    several = replace(several, time=jnp.stack([lines.time, 1 - lines.time]))
    together, _ = look(motion, several, options=OPTIONS, capacity=ROOM)
    for i in range(2):
        own, seen = (jax.tree.map(lambda x: x[i], x) for x in (several, together))  # noqa: B023
        expected, _ = look(motion, own, options=OPTIONS, capacity=ROOM)
        np.testing.assert_allclose(stacked(seen), stacked(expected), atol=SAME)


def test_what_is_not_alive_enters_no_list():
    lines = replace(shot(rays()), time=jnp.full(RAYS, 0.5, jnp.float32))
    few = fleeting(COUNT, seed=3, size=(0.05, 0.4), lifetime=(0.01, 0.02), speed=0.0)
    # At full opacity all are in front of the camera.
    instant = jnp.where(jnp.arange(COUNT) % 4, 10.0, 0.5)
    motion = alone(replace(few, instant=instant), np.float32)
    pixels, report = look(motion, lines, options=OPTIONS, capacity=ROOM)
    living = jax.tree.map(lambda x: x[::4], replace(few, instant=instant))
    expected, least = look(alone(living, np.float32), lines, options=OPTIONS, capacity=ROOM)
    assert int(report.needed[-1]) == COUNT // 4
    np.testing.assert_array_equal(report.needed, least.needed)
    np.testing.assert_allclose(stacked(pixels), stacked(expected), atol=SAME)


def test_bundles_list_only_what_lives_in_their_own_time():
    lines = shot(rays())
    # Half of the bundles look at the time 0, the others at 1.
    lines = replace(lines, time=jnp.where(jnp.arange(RAYS) < RAYS // 2, 0.0, 1.0))
    lines = cast(lines, np.float32)
    short = fleeting(COUNT, seed=3, size=(0.5, 1.0), lifetime=(0.01, 0.02), speed=0.0)
    early = replace(short, instant=jnp.zeros(COUNT), opacity=jnp.full(COUNT, 0.1))
    both = look(alone(early, np.float32), lines, options=OPTIONS, capacity=ROOM)[1]
    first = jax.tree.map(lambda x: x[: RAYS // 2], lines)
    one = look(alone(early, np.float32), first, options=OPTIONS, capacity=ROOM)[1]
    assert int(both.needed[-3]) == int(one.needed[-3]) > 0


def test_too_many_alive_are_counted_and_measured():
    motion, lines = scene(dtype=np.float32), shot(rays())
    _, report = look(motion, lines, options=OPTIONS, capacity=replace(ROOM, transient=5))
    alive = int(report.needed[-1])
    assert int(report.dropped) == alive - 5 > 0
    capacity = measure(motion, lines, options=OPTIONS)
    assert alive <= capacity.transient <= 2 * alive
    pixels, report = look(motion, lines, options=OPTIONS, capacity=capacity)
    assert int(report.dropped) == 0
    expected, _ = look(motion, lines, options=OPTIONS, capacity=ROOM)
    np.testing.assert_allclose(stacked(pixels), stacked(expected), atol=SAME)


@pytest.mark.parametrize("name", ["instant", "lifetime", "plateau", "velocity", "mean"])
def test_what_is_not_finite_is_skipped_and_spreads_no_gradient(name):
    motion, lines = scene(dtype=np.float32), shot(rays())
    value = getattr(motion.transient, name)
    broken = replace(motion.transient, **{name: value.at[7].set(jnp.nan)})
    weight = weights(dtype=np.float32)
    pixels, report, gradient = pull(
        replace(motion, transient=broken), lines, weight, options=OPTIONS, capacity=ROOM
    )
    assert int(report.skipped) == 1
    assert all(np.all(np.isfinite(x)) for x in jax.tree.leaves((pixels, gradient)))


def test_without_transients_no_size_is_reported_for_them():
    motion, lines = resting(gaussians(COUNT)), shot(rays())
    _, report = look(motion, lines, options=OPTIONS, capacity=CAPACITY)
    assert len(report.needed) == len(CAPACITY.cells) + 2
    assert prepare(motion, span_of(lines), options=OPTIONS, capacity=CAPACITY).living is None
    empty = beside(motion, fleeting(0))
    pixels, _ = look(empty, lines, options=OPTIONS, capacity=ROOM)
    expected, _ = look(motion, lines, options=OPTIONS, capacity=CAPACITY)
    # Two programs, which may add up in another order.
    np.testing.assert_allclose(stacked(pixels), stacked(expected), rtol=0, atol=SAME)


def test_the_dominant_gaussian_is_told_by_its_number_among_all():
    lines = replace(shot(rays()), time=jnp.full(RAYS, 0.5, jnp.float32))
    motion = scene(dtype=np.float32)
    best = jax.jit(
        lambda m, r: dominant(m, r, options=OPTIONS, capacity=ROOM),
    )(motion, lines)
    t, alpha = reference.hits(motion, lines)
    order = np.argsort(t, axis=1)
    sorted_alpha = np.take_along_axis(alpha, order, 1)
    clear = np.cumprod(1 - sorted_alpha, axis=1) / np.maximum(1 - sorted_alpha, 1e-12)
    expected = np.take_along_axis(order, np.argmax(sorted_alpha * clear, axis=1)[:, None], 1)[:, 0]
    seen = alpha.max(axis=1) > 0
    np.testing.assert_array_equal(np.asarray(best.index)[seen], expected[seen])
    assert (np.asarray(best.index) >= COUNT).any()
