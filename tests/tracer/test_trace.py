"""The whole tracer: against brute force, by its laws, and what it reports."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
from pictures import LENSES, seen_through
from scenes import (
    CAPACITY,
    COUNT,
    OPTIONS,
    RAYS,
    Lines,
    against_brute_force,
    gaussians,
    look,
    moving,
    natural,
    padded,
    pull,
    pull_dense,
    rays,
    relative_errors,
    resting,
    shot,
    stacked,
    tinted,
    wandering,
    weights,
)

from gaussray.geometry import quaternion, rotation_matrix
from gaussray.tracer import march
from gaussray.tracer.bundle import coherent_order
from gaussray.tracer.motion import Motion
from gaussray.tracer.options import TraceOptions
from gaussray.tracer.trace import total_hits, trace
from gaussray.tracer.traverse import Capacity


# Lenses whose rays differ in kind; those of the others go about like theirs.
FEW = ("pinhole", "distorted", "polynomial", "kannala", "double_sphere", "sphere")
slow = pytest.mark.slow
# Asked of single precision: mean absolute colour, and gradients relative to the largest.
COLOR, GRADIENT = 1e-4, 1e-3
# What single precision reaches where nothing is extreme: a hundred roundings (measured: 2e-6).
SINGLE = 1e-5
# Double precision: the same formulas in another order.
EXACT = 1e-9
# Central differences of the brute force.
STEP, DIFFERENCES = 1e-6, 1e-6
# Single precision with the work cut differently: rounding, and exchanged hits at equal distance.
SAME = 5e-6


@pytest.mark.parametrize("lens", [pytest.param(x, marks=() if x in FEW else slow) for x in LENSES])
@pytest.mark.parametrize("count", [1, 40])
def test_values_and_gradients_are_those_of_the_brute_force(count, lens):
    lines = seen_through(lens)
    crowd = gaussians(count, seed=count, size=(0.1, 0.5))
    if count == 1:
        crowd = crowd._replace(mean=(lines.origin + 1.5 * lines.direction)[20:21])
    color, errors, report = against_brute_force(resting(padded(crowd)), lines)
    assert int(report.hits) > 0
    assert color < COLOR
    assert max(errors.values()) < GRADIENT, errors


def test_no_gaussians_are_seen_as_nothing():
    empty = jax.tree.map(lambda x: x[:0], gaussians(1))
    pixels, report, gradient = pull(
        resting(empty), shot(rays()), weights(dtype=np.float32), capacity=Capacity((1, 1), 1, 1)
    )
    np.testing.assert_array_equal(stacked(pixels), np.tile([0, 0, 0, 1.0, 0], (RAYS, 1)))
    assert int(report.dropped) == int(report.hits) == 0
    assert not any(np.any(x) for x in jax.tree.leaves(gradient))


def test_gradients_through_several_rounds_are_those_of_plain_autodiff():
    motion, lines = resting(gaussians(COUNT, size=(0.1, 0.5))), rays()
    color, errors, report = against_brute_force(motion, lines)
    assert int(report.hits) > 3 * OPTIONS.k * RAYS
    assert color < SINGLE and max(errors.values()) < SINGLE, errors


@pytest.mark.parametrize("keys", [pytest.param(1, marks=pytest.mark.slow), 3])
def test_tints_are_those_of_the_brute_force(keys):
    if keys == 1:
        motion = resting(gaussians(COUNT, size=(0.1, 0.5)))
    else:
        motion = wandering(*moving(COUNT, keys, size=(0.1, 0.5), amount=0.02))
    color, errors, _ = against_brute_force(tinted(motion), rays())
    assert "tint" in errors
    # Blended axes lose some digits of single precision where a Gaussian is thin.
    assert color < COLOR and max(errors.values()) < GRADIENT, errors


def test_a_tint_of_one_changes_nothing(plain):
    # With key states, all alike, so that the program is that of other tints.
    _, lines, image = plain
    keys = np.linspace(0, 1, 3)
    still = gaussians(COUNT, size=(0.1, 0.5))
    states = {name: np.stack([getattr(still, name)] * 3) for name in ("mean", "quat", "scale")}
    motion = tinted(wandering(keys, still._replace(**states)))
    white = eqx.tree_at(lambda m: m.gaussians.tint, motion, jnp.ones_like(motion.gaussians.mean))
    np.testing.assert_allclose(see(white, lines), image, atol=SAME)


def test_hits_that_were_not_kept_are_found_again_for_the_gradients(monkeypatch):
    monkeypatch.setattr(march, "_STORED", 8)
    # A chunk that no other test has, so that this is compiled anew.
    options = replace(OPTIONS, chunk=6)
    motion, lines = resting(gaussians(COUNT, size=(0.1, 0.5))), rays()
    color, errors, report = against_brute_force(motion, lines, options)
    assert int(report.hits) > 3 * options.k * RAYS
    assert color < SINGLE and max(errors.values()) < SINGLE, errors


@pytest.mark.ci
def test_gradients_of_moving_gaussians_reach_the_time():
    motion = wandering(*moving(COUNT, size=(0.1, 0.5)), np.float64)
    lines = shot(rays(), np.float64)
    pixels, report, gradient = pull(motion, lines, weights())
    assert int(report.hits) > 3 * OPTIONS.k * RAYS
    np.testing.assert_allclose(stacked(pixels), stacked(reference.trace(motion, lines)), atol=EXACT)
    slope = pull_dense(motion, lines, weights())
    errors = relative_errors(natural(gradient, motion), natural(slope, motion))
    assert max(errors.values()) < EXACT, errors
    np.testing.assert_allclose(gradient[0].time, slope[0].time, atol=EXACT)
    assert np.any(gradient[1].time) and np.any(gradient[0].time)


def test_gradients_are_the_finite_differences_of_the_brute_force():
    # Few and opaque enough: no Gaussian crosses a cut-off within the step.
    time, matter = moving(COUNT, size=(0.1, 0.5))
    motion, lines = wandering(time, matter, np.float64), shot(rays(), np.float64)
    _, _, gradient = pull(motion, lines, weights())
    r = np.random.default_rng(2)
    tree = (motion, lines)
    leaves, structure = jax.tree.flatten(tree)
    w = np.asarray(weights())

    def value(way, step):
        moved = jax.tree.map(lambda x, d: x + step * d, tree, way)
        color, transmittance, depth = reference.trace(*moved)
        return np.sum(w[:, :3] * color) + w[:, 3] @ transmittance + 0.1 * w[:, 4] @ depth

    # One kind of parameter at a time, so that a large gradient does not hide a small one.
    for i, slope in enumerate(jax.tree.leaves(gradient)):
        way = [r.normal(size=x.shape) * (i == j) for j, x in enumerate(leaves)]
        along = np.sum(np.asarray(slope) * way[i])
        way = jax.tree.unflatten(structure, [jnp.asarray(x) for x in way])
        difference = (value(way, STEP) - value(way, -STEP)) / (2 * STEP)
        np.testing.assert_allclose(along, difference, rtol=DIFFERENCES, atol=DIFFERENCES)


@pytest.fixture(scope="module")
def plain():
    """A scene, rays and what the common options see."""
    motion, lines = resting(gaussians(COUNT, size=(0.1, 0.5))), shot(rays())
    return motion, lines, see(motion, lines)


def see(motion, lines):
    return stacked(pull(motion, lines, weights(dtype=np.float32))[0])


@pytest.mark.parametrize(
    "options",
    [
        TraceOptions(k=1, bundle=4, levels=0, group=3, chunk=5, transmittance_min=0.0),
        TraceOptions(k=16, bundle=1, levels=2, group=16, chunk=64, transmittance_min=0.0),
    ],
)
def test_how_the_work_is_cut_does_not_matter_nor_rays_that_do_not_fill_bundles(options):
    motion = resting(gaussians(COUNT, size=(0.1, 0.5), degree=3))
    lines = shot(jax.tree.map(lambda x: x[:61], rays()))
    capacity = Capacity((512,) * (options.levels + 1), 16_384, 64)
    pixels, report = look(motion, lines, options=options, capacity=capacity)
    np.testing.assert_allclose(stacked(pixels), stacked(reference.trace(motion, lines)), atol=SAME)
    assert int(report.hits) == np.sum(np.isfinite(reference.hits(motion, lines)[0]))
    assert int(report.dropped) == 0


def test_rays_in_any_order_see_the_same_through_coherent_order(plain):
    motion, lines, image = plain
    order = np.asarray(jax.jit(coherent_order)(lines))
    assert sorted(order) == list(range(RAYS))
    gathered = see(motion, jax.tree.map(lambda x: x[order], lines))
    np.testing.assert_allclose(gathered, image[order], atol=SAME)


def test_order_of_gaussians_does_not_matter(plain):
    _, lines, image = plain
    order = np.random.default_rng(3).permutation(COUNT)
    shuffled = jax.tree.map(lambda x: x[order], gaussians(COUNT, size=(0.1, 0.5)))
    np.testing.assert_allclose(see(resting(shuffled), lines), image, atol=SAME)


def test_gaussians_of_opacity_zero_have_no_effect():
    crowd = gaussians(COUNT, size=(0.1, 0.5))
    opacity = np.where(np.arange(COUNT) < 40, crowd.opacity, 0)
    few = jax.tree.map(lambda x: x[:40], crowd)
    image = see(resting(crowd._replace(opacity=opacity)), shot(rays()))
    expected = stacked(reference.trace(resting(few, np.float64), rays()))
    np.testing.assert_allclose(image, expected, atol=SAME)


def test_scene_and_rays_moved_together_look_the_same():
    (time, matter), lines = moving(COUNT, size=(0.1, 0.5)), rays()
    matter.harmonics[:, 1:] = 0  # Colours that change with the direction do not turn along.
    before, _, _ = pull(wandering(time, matter, np.float64), shot(lines, np.float64), weights())
    turn = np.asarray(rotation_matrix(jnp.array([0.3, -0.5, 0.7, 0.2])))
    shift = np.array([3.0, -1.0, 2.0])
    own = turn @ reference.rotation(matter.quat)
    quat = jax.vmap(jax.vmap(quaternion))(jnp.asarray(own))
    moved = matter._replace(mean=matter.mean @ turn.T + shift, quat=np.asarray(quat))
    carried = lines._replace(
        origin=lines.origin @ turn.T + shift, direction=lines.direction @ turn.T
    )
    after, _, _ = pull(wandering(time, moved, np.float64), shot(carried, np.float64), weights())
    np.testing.assert_allclose(stacked(after), stacked(before), atol=EXACT)


def test_at_a_key_time_the_scene_is_that_key_state():
    time, matter = moving(COUNT, size=(0.1, 0.5))
    for key in range(len(time)):
        lines = rays()._replace(time=np.full(RAYS, time[key]))
        pixels, _, _ = pull(wandering(time, matter, np.float64), shot(lines, np.float64), weights())
        state = matter._replace(
            mean=matter.mean[key], quat=matter.quat[key], scale=matter.scale[key]
        )
        expected = stacked(reference.trace(resting(state, np.float64), lines))
        np.testing.assert_allclose(stacked(pixels), expected, atol=EXACT)


def test_before_the_first_and_after_the_last_key_the_scene_rests():
    time, matter = moving(COUNT, size=(0.1, 0.5))
    motion = wandering(time, matter, np.float64)
    for key, beyond in ((time[0], -3.0), (time[-1], 7.0)):
        images = [
            pull(motion, shot(rays()._replace(time=np.full(RAYS, t)), np.float64), weights())[0]
            for t in (key, beyond)
        ]
        np.testing.assert_allclose(stacked(images[1]), stacked(images[0]), atol=EXACT)


def test_gaussians_that_are_not_finite_are_counted_and_harm_nothing():
    crowd = gaussians(COUNT, size=(0.1, 0.5))
    crowd.mean[0] = np.nan
    crowd.quat[7, 2] = np.inf
    crowd.scale[11, 1] = np.nan
    crowd.opacity[20] = np.nan
    crowd.harmonics[33, 2, 1] = np.nan
    crowd.scale[40, 0] = 0.0
    broken = [0, 7, 11, 20, 33, 40]
    pixels, report, gradient = pull(resting(crowd), shot(rays()), weights(dtype=np.float32))
    assert int(report.skipped) == len(broken)
    whole = gaussians(COUNT, size=(0.1, 0.5))
    whole.opacity[broken] = 0
    expected, _, slope = pull(resting(whole), shot(rays()), weights(dtype=np.float32))
    np.testing.assert_allclose(stacked(pixels), stacked(expected), atol=SAME)
    for a, b in zip(jax.tree.leaves(gradient), jax.tree.leaves(slope), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-4)


def test_what_rays_see_does_not_depend_on_the_room_that_lists_have():
    # Discs whose distances differ by less than keys of 14 slot bits can tell, beside one far away.
    crowd = gaussians(COUNT, size=(0.3, 0.6))
    crowd.mean[:, 2] *= 1e-5
    crowd.scale[:, 2], crowd.quat[:] = 1e-6, (1, 0, 0, 0)
    crowd.mean[0, 2], crowd.scale[0] = 3.0, 2.0
    lines = rays(jitter=0.0, spread=0.1)
    seen = [
        stacked(look(resting(crowd), shot(lines), options=OPTIONS, capacity=capacity)[0])
        for capacity in (CAPACITY, Capacity((64, 512), 8192, 1 << 14))
    ]
    np.testing.assert_array_equal(*seen)


def test_rays_without_direction_see_nothing_and_rays_that_are_nan_harm_no_other(plain):
    motion, lines, image = plain
    direction, origin = np.array(lines.direction), np.array(lines.origin)
    direction[[3, 30]] = 0
    origin[[9, 50]] = np.nan
    odd = shot(Lines(origin, direction, lines.time))
    pixels, _, (slope, _) = pull(motion, odd, weights(dtype=np.float32))
    others = np.setdiff1d(np.arange(RAYS), [3, 30, 9, 50])
    seen = stacked(pixels)
    np.testing.assert_array_equal(seen[[3, 30]], np.tile([0, 0, 0, 1.0, 0], (2, 1)))
    np.testing.assert_allclose(seen[others], image[others], atol=SAME)
    assert all(np.all(np.isfinite(x)) for x in jax.tree.leaves(slope))


def test_a_gaussian_that_turns_over_between_keys_does_not_flash():
    # Half a turn about z. At time 1/4 the first key's share is (1/4 - 3/4) (1/4 - 1) / (3/4) = 1/2,
    # that of the others together too: the axes vanish, and with them the Gaussian.
    crowd = padded(gaussians(1)._replace(mean=np.zeros((1, 3)), scale=np.full((1, 3), 0.125)))
    over = crowd.quat.copy()
    crowd.quat[0], over[0] = (1, 0, 0, 0), (0, 0, 0, 1)
    both = [np.stack([x, x, x]) for x in (crowd.mean, crowd.scale)]
    state = crowd._replace(mean=both[0], scale=both[1], quat=np.stack([crowd.quat, over, over]))
    motion = wandering([0.0, 0.75, 1.0], state, np.float64)
    lines = rays(spread=0.01, jitter=0.05)._replace(time=np.full(RAYS, 0.25))
    pixels, _, gradient = pull(motion, shot(lines, np.float64), weights())
    assert np.all(stacked(pixels)[:, 3] == 1)
    assert all(np.all(np.isfinite(x)) for x in jax.tree.leaves(gradient))


def test_stopping_early_costs_no_more_than_the_light_that_is_left():
    options = TraceOptions(k=4, bundle=2, levels=1, group=4, chunk=8, transmittance_min=0.1)
    crowd = gaussians(COUNT, size=(0.3, 0.6))
    lines = rays()
    pixels, report = look(resting(crowd), shot(lines), options=options, capacity=CAPACITY)
    color, left, _ = reference.trace(resting(crowd, np.float64), lines)
    brightest = np.max(reference.light(crowd.harmonics, lines.direction))
    seen = stacked(pixels)
    assert np.all(np.abs(seen[:, :3] - color) <= 0.1 * brightest + SAME)
    assert np.all(seen[:, 3] >= left - SAME)
    assert int(report.hits) < np.sum(np.isfinite(reference.hits(resting(crowd), lines)[0]))


def test_one_compilation_serves_all_values_of_a_single_gaussian():
    once = eqx.filter_jit(eqx.debug.assert_max_traces(trace, max_traces=1))
    options = TraceOptions(k=2, bundle=2, levels=0, group=4, chunk=8)
    for seed in range(3):
        motion = resting(gaussians(1, seed=seed, size=(0.2, 1.0 + seed)))
        motion = Motion(motion.time + seed, motion.gaussians)
        lines = shot(rays(16, seed=seed))
        pixels, _ = once(motion, lines, options=options, capacity=Capacity((4,), 4, 1))
        np.testing.assert_allclose(
            stacked(pixels), stacked(reference.trace(motion, lines)), atol=SAME
        )


def test_options_are_static_and_say_what_is_wrong():
    assert not jax.tree.leaves(TraceOptions())
    for wrong in ({"k": 0}, {"levels": 5}, {"alpha_min": 0.0}, {"transmittance_min": 1.0}):
        with pytest.raises(ValueError, match=f"trace.{next(iter(wrong))} "):
            TraceOptions(**wrong)


def test_hits_are_told_exactly_while_they_are_few_and_beyond_32_bits():
    few, many = (total_hits(jnp.full(5, n, jnp.int32)) for n in (3_000_001, 2**30))
    assert int(few) == 15_000_005 and int(many) == 5 * 2**30
