"""Transient Gaussians along rays: exact at every ray's time, free where they do not live."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
from dominants import dominant_of
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
    score,
    shot,
    stacked,
    wandering,
    weights,
)

from gaussray.scene.transient import Transients
from gaussray.tracer.alive_transients import most_alive
from gaussray.tracer.measure import measure
from gaussray.tracer.motion import Motion
from gaussray.tracer.prepare import prepare, time_span
from gaussray.tracer.trace import trace


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


def alone(transients):
    """Transient Gaussians and nothing else that is seen; alike in size to `scene`, so that both
    share programs."""
    nothing = gaussians(COUNT)._replace(opacity=np.zeros(COUNT))
    return beside(resting(nothing, np.float64), transients, (0.0, 1.0))


def one_transient(plateau=0.05):
    """A ball at (0, 0, 3) at the time 0.5 that goes to +x, among others of opacity 0."""
    parts = {
        "mean": [0, 0, 3],
        "velocity": [1, 0, 0],
        "quat": [1, 0, 0, 0],
        "scale": [0.2] * 3,
        "opacity": 0.8,
        "harmonics": [[0.5, 0, -0.5], *np.zeros((3, 3))],
        "instant": 0.5,
        "lifetime": 0.1,
        "plateau": plateau,
    }
    many = {k: np.repeat(np.array(v, float)[None], COUNT, axis=0) for k, v in parts.items()}
    many["opacity"][1:] = 0
    return Transients(**{k: jnp.asarray(v) for k, v in many.items()})


def one_ray(x, time):
    """A ray along +z at a place and a time, many times."""
    one = Lines(np.array([x, 0, 0]), np.array([0, 0, 1.0]), np.array(time))
    return shot(jax.tree.map(lambda x: np.repeat(x[None], RAYS, axis=0), one), np.float64)


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
    ball = one_transient(plateau=0.0)
    for age in (0.05, 0.1, 0.2):
        pixels, _ = look(alone(ball), one_ray(age, 0.5 + age), options=OPTIONS, capacity=ROOM)
        alpha = 0.8 * np.exp(-0.5 * (age / 0.1) ** 2)
        np.testing.assert_allclose(1 - pixels.transmittance, alpha, atol=DOUBLE)


def assert_seen(pixels, report, motion, lines):
    """The picture of brute force."""
    assert int(report.dropped) == 0 and int(report.hits) > 4 * RAYS
    np.testing.assert_allclose(
        stacked(pixels), stacked(reference.trace(motion, lines)), atol=DOUBLE
    )


@pytest.mark.parametrize("keys", [1, 3])
def test_pictures_between_two_times_are_those_of_all_gaussians_on_every_ray(keys):
    motion, lines = scene(keys, time_range=(0.3, 0.6)), shot(rays(), np.float64)
    assert_seen(*look(motion, lines, options=OPTIONS, capacity=ROOM), motion, lines)


@pytest.mark.ci
@pytest.mark.parametrize("keys", [1, 3])
def test_pictures_and_gradients_are_those_of_all_gaussians_on_every_ray(keys):
    motion, lines, weight = scene(keys), shot(rays(), np.float64), weights()
    pixels, report, gradient = pull(motion, lines, weight, options=OPTIONS, capacity=ROOM)
    assert_seen(pixels, report, motion, lines)
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

    weight = weights(16)

    @jax.jit
    @jax.value_and_grad
    def seen(values):
        own = replace(motion, transient=replace(transients, **{k: values[k] for k in names}))
        filmed = replace(lines, time=values["time"])
        pixels, _ = trace(own, filmed, options=options, capacity=ROOM)
        return score((pixels.color, pixels.transmittance, pixels.depth), weight)

    values = {name: getattr(transients, name) for name in names} | {"time": lines.time}
    _, slope = seen(values)
    r, eps = np.random.default_rng(0), 1e-6
    # Away from where a plateau begins: the second derivative is not continuous there.
    for name, value in values.items():
        way = eps * r.normal(size=value.shape)
        more, less = (seen(values | {name: value + step})[0] for step in (way, -way))
        along = np.sum(np.asarray(slope[name]) * way) / eps
        np.testing.assert_allclose(along, (more - less) / (2 * eps), rtol=1e-3, atol=1e-4)


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
    zero = jnp.zeros(COUNT)
    eternal = Transients(
        crowd.mean, 0 * crowd.mean, *crowd[1:], instant=zero, lifetime=zero + jnp.inf, plateau=zero
    )
    static = beside(resting(crowd, np.float64), replace(eternal, opacity=zero), (0.0, 1.0))
    expected, _ = look(static, lines, options=OPTIONS, capacity=ROOM)
    pixels, report = look(alone(eternal), lines, options=OPTIONS, capacity=ROOM)
    assert int(report.skipped) == 0
    np.testing.assert_allclose(stacked(pixels), stacked(expected), atol=DOUBLE)


def test_a_rolling_shutter_sees_in_every_row_what_an_instant_sees_there():
    motion, lines = scene(time_range=(0, 1)), shot(rays(), np.float64)
    rows = np.arange(RAYS) // 16 / 4
    rolled = replace(lines, time=jnp.asarray(rows))
    together, _ = look(motion, rolled, options=OPTIONS, capacity=ROOM)
    for row in range(4):
        instant = replace(lines, time=jnp.full(RAYS, row / 4, float))
        frozen, _ = look(motion, instant, options=OPTIONS, capacity=ROOM)
        mine = rows == row / 4
        np.testing.assert_allclose(stacked(together)[mine], stacked(frozen)[mine], atol=SAME)


def test_samples_share_lists_and_see_what_each_would_see_alone():
    motion, lines = scene(3, time_range=(0, 1)), shot(rays(), np.float64)
    several = jax.tree.map(lambda x: jnp.stack([x, x]), lines)
    several = replace(several, time=jnp.stack([lines.time, 1 - lines.time]))
    together, _ = look(motion, several, options=OPTIONS, capacity=ROOM)
    for i in range(2):
        own, seen = (jax.tree.map(lambda x: x[i], x) for x in (several, together))  # noqa: B023
        expected, _ = look(motion, own, options=OPTIONS, capacity=ROOM)
        np.testing.assert_allclose(stacked(seen), stacked(expected), atol=SAME)


def test_what_is_not_alive_enters_no_list():
    lines = replace(shot(rays(), np.float64), time=jnp.full(RAYS, 0.5, float))
    few = fleeting(COUNT, seed=3, size=(0.05, 0.4), lifetime=(0.01, 0.02), speed=0.0)
    # At full opacity all are in front of the camera.
    instant = jnp.where(jnp.arange(COUNT) % 4, 10.0, 0.5)
    motion = alone(replace(few, instant=instant))
    pixels, report = look(motion, lines, options=OPTIONS, capacity=ROOM)
    living = jax.tree.map(lambda x: x[::4], replace(few, instant=instant))
    expected, least = look(alone(living), lines, options=OPTIONS, capacity=ROOM)
    assert int(report.needed[-1]) == COUNT // 4
    np.testing.assert_array_equal(report.needed, least.needed)
    np.testing.assert_allclose(stacked(pixels), stacked(expected), atol=SAME)


def test_bundles_list_only_what_lives_in_their_own_time():
    lines = shot(rays())
    # Half of the bundles look at the time 0, the others at 1.
    lines = replace(lines, time=jnp.where(jnp.arange(RAYS) < RAYS // 2, 0.0, 1.0))
    lines = cast(lines, np.float64)
    short = fleeting(COUNT, seed=3, size=(0.5, 1.0), lifetime=(0.01, 0.02), speed=0.0)
    early = replace(short, instant=jnp.zeros(COUNT), opacity=jnp.full(COUNT, 0.1))
    both = look(alone(early), lines, options=OPTIONS, capacity=ROOM)[1]
    first = jax.tree.map(lambda x: x[: RAYS // 2], lines)
    one = look(alone(early), first, options=OPTIONS, capacity=ROOM)[1]
    assert int(both.needed[-3]) == int(one.needed[-3]) > 0


@pytest.mark.ci
def test_too_many_alive_are_counted_and_measured():
    motion, lines = scene(time_range=(0, 1)), shot(rays(), np.float64)
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
    # As if it could not be seen.
    opacity = motion.transient.opacity.at[7].set(0)
    unseen = replace(motion, transient=replace(motion.transient, opacity=opacity))
    expected, _, slope = pull(unseen, lines, weight, options=OPTIONS, capacity=ROOM)
    np.testing.assert_allclose(stacked(pixels), stacked(expected), atol=COLOR)
    for a, b in zip(jax.tree.leaves(gradient), jax.tree.leaves(slope), strict=True):
        np.testing.assert_allclose(a, b, atol=GRADIENT * np.abs(b).max())


def test_there_are_no_more_places_than_transient_gaussians():
    many = replace(ROOM, transient=10 * COUNT)
    prepared = prepare(scene(), jnp.asarray([0.0, 1.0]), options=OPTIONS, capacity=many)
    assert prepared.motion.transient.count == COUNT


def test_without_transients_no_size_is_reported_for_them():
    motion, lines = resting(gaussians(COUNT)), shot(rays())
    _, report = look(motion, lines, options=OPTIONS, capacity=CAPACITY)
    assert len(report.needed) == len(CAPACITY.cells) + 2
    prepared = jax.eval_shape(
        lambda m, r: prepare(m, time_span(r), options=OPTIONS, capacity=CAPACITY), motion, lines
    )
    assert prepared.living is None
    empty = beside(motion, fleeting(0))
    pixels, _ = look(empty, lines, options=OPTIONS, capacity=ROOM)
    expected, _ = look(motion, lines, options=OPTIONS, capacity=CAPACITY)
    # Two programs, which may add up in another order.
    np.testing.assert_allclose(stacked(pixels), stacked(expected), rtol=0, atol=SAME)


def test_most_alive_are_as_many_as_are_within_their_lifetimes():
    brief, times = fleeting(500), np.linspace(-0.5, 1.5, 23)
    away = np.abs(times[:, None] - np.asarray(brief.instant)) - np.asarray(brief.plateau)
    shown = np.exp(-0.5 * np.square(np.maximum(away, 0) / np.asarray(brief.lifetime))) > 1 / 255
    most = np.max(np.sum(shown, axis=1))
    # Its bound is a little wider.
    assert 0 < most <= most_alive(brief, times) <= 1.1 * most
    assert most_alive(brief, times[:1]) < most / 2


def test_the_dominant_gaussian_is_told_by_its_number_among_all():
    lines = replace(shot(rays()), time=jnp.full(RAYS, 0.5, jnp.float32))
    motion = scene(dtype=np.float32)
    best = jax.jit(
        lambda m, r: dominant_of(m, r, options=OPTIONS, capacity=ROOM),
    )(motion, lines)
    t, alpha = reference.hits(motion, lines)
    order = np.argsort(t, axis=1)
    sorted_alpha = np.take_along_axis(alpha, order, 1)
    clear = np.cumprod(1 - sorted_alpha, axis=1) / np.maximum(1 - sorted_alpha, 1e-12)
    expected = np.take_along_axis(order, np.argmax(sorted_alpha * clear, axis=1)[:, None], 1)[:, 0]
    seen = alpha.max(axis=1) > 0
    np.testing.assert_array_equal(np.asarray(best.index)[seen], expected[seen])
    assert (np.asarray(best.index) >= COUNT).any()
