"""The march in machine code on a CPU: it sees and learns what the brute force says in float64; how
the work is spread does not matter; where it is chosen."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

import equinox as eqx
import extremes
import jax
import jax.numpy as jnp
import numba
import numpy as np
import pytest
import reference
from scenes import (
    CAPACITY,
    COUNT,
    OPTIONS,
    RAYS,
    beside,
    fleeting,
    gaussians,
    look,
    moving,
    pull,
    rays,
    resting,
    score,
    shot,
    stacked,
    tinted,
    wandering,
    weights,
)
from single import COLOR, GRADIENT, SINGLE, errors_on_device, mixed, pile, roomy, sheet

from gaussray.tracer import options as tracer_options
from gaussray.tracer.cpu import march as cpu_march, meet as cpu_meet
from gaussray.tracer.cpu.block import LANES
from gaussray.tracer.cpu.sort import sort_lanes
from gaussray.tracer.march import march
from gaussray.tracer.measure import measure
from gaussray.tracer.options import TraceOptions, on_cpu_kernel, on_kernel
from gaussray.tracer.prepare import prepare, time_span
from gaussray.tracer.trace import find_candidates, march_function, march_lists, trace


SIZES = {"size": (0.1, 0.5)}


@pytest.fixture(autouse=True)
def on_a_cpu():
    if jax.default_backend() != "cpu":
        pytest.skip("JAX's default device is no CPU")


def test_single_precision_chooses_machine_code_and_other_choices_the_arrays():
    assert on_cpu_kernel(TraceOptions(), jnp.float32)
    assert not on_cpu_kernel(TraceOptions(), jnp.float64)
    assert not on_cpu_kernel(TraceOptions(backend="array"), jnp.float32)
    assert march_function(TraceOptions(), jnp.float32) is cpu_march.march_on_cpu
    assert march_function(TraceOptions(backend="array"), jnp.float32) is march
    assert not on_kernel(TraceOptions(backend="kernel"), jnp.float32)


def test_without_numba_the_arrays_march_and_the_kernel_is_refused(monkeypatch):
    monkeypatch.setattr(tracer_options, "runs_machine_code", lambda: False)
    assert march_function(TraceOptions(), jnp.float32) is march
    with pytest.raises(ValueError, match="trace.backend=kernel needs a CUDA device.* Numba"):
        on_kernel(TraceOptions(backend="kernel"), jnp.float32)


@pytest.mark.parametrize(
    "change", [{}, {"levels": 0}, {"bundle": 1}, {"bundle": 8}, {"bundle": 12}]
)
def test_how_the_work_is_cut_does_not_matter(change):
    motion = resting(gaussians(COUNT, **SIZES))
    color, errors = errors_on_device(motion, rays(), replace(OPTIONS, **change))
    assert color < SINGLE and max(errors.values()) < SINGLE, errors


@pytest.mark.parametrize("degree", [0, 2, 3])
def test_every_degree_of_colour(degree):
    motion = resting(gaussians(COUNT, degree=degree, **SIZES))
    color, errors = errors_on_device(motion, rays())
    assert color < SINGLE and max(errors.values()) < SINGLE, errors


@pytest.mark.ci
@pytest.mark.parametrize("keys", [1, 2, 3])
def test_key_states_and_tints(keys):
    if keys == 1:
        motion = resting(gaussians(COUNT, **SIZES))
    else:
        motion = wandering(*moving(COUNT, keys, amount=0.02, **SIZES))
    color, errors = errors_on_device(tinted(motion), rays())
    # Blended axes lose some digits of single precision where a Gaussian is thin.
    assert color < COLOR and max(errors.values()) < GRADIENT, errors


@pytest.mark.ci
@pytest.mark.parametrize("scene", ["resting", "moving", "mixed"])
def test_transient_gaussians_at_times_of_rays(scene):
    motion = {
        "resting": lambda: resting(gaussians(COUNT, **SIZES)),
        "moving": lambda: wandering(*moving(COUNT, 3, amount=0.02, **SIZES)),
        "mixed": mixed,
    }[scene]()
    motion = beside(motion, fleeting(COUNT, seed=3, **SIZES), (0.1, 0.8))
    color, errors = errors_on_device(motion, rays())
    assert color < COLOR and max(errors.values()) < GRADIENT, errors


@pytest.mark.parametrize("name", sorted(set(extremes.SCENES) - {"anisotropy", "upright"}))
def test_the_ends_of_what_numbers_can_express(name):
    crowd, lines = extremes.scene(name)
    color, errors = errors_on_device(resting(crowd), lines)
    assert color < COLOR and max(errors.values()) < GRADIENT, errors


def test_a_ray_ends_when_its_light_is_spent():
    motion, lines = resting(gaussians(COUNT, size=(0.5, 1.0))), shot(rays())
    weight, ends = weights(dtype=np.float32), replace(OPTIONS, transmittance_min=0.1)
    whole, _, _ = pull(motion, lines, weight, capacity=roomy(OPTIONS))
    cut, report, _ = pull(motion, lines, weight, options=ends, capacity=roomy(OPTIONS))
    left = np.asarray(cut.transmittance)
    assert left.min() < 0.1 and int(report.hits) < RAYS * COUNT
    # What is missing lies behind what light is left.
    assert np.all(np.abs(np.asarray(whole.color - cut.color)).max(axis=1) < 5 * 0.1)
    unspent = left > 0.1
    np.testing.assert_array_equal(stacked(whole)[unspent], stacked(cut)[unspent])


def test_threads_change_not_a_bit(monkeypatch):
    motion = beside(resting(gaussians(COUNT, **SIZES)), fleeting(COUNT, seed=3, **SIZES))
    lines, weight = jax.tree.map(lambda x: x[None], shot(rays())), weights(dtype=np.float32)

    @jax.jit
    def listed(motion):
        scene = prepare(motion, time_span(lines), options=OPTIONS, capacity=CAPACITY)
        return scene.motion, find_candidates(scene, lines, options=OPTIONS, capacity=CAPACITY)[0]

    def loss(motion, lines, lists):
        pixels, hits = march_lists(motion, lines, lists, options=OPTIONS, slots=CAPACITY.slots)
        seen = (pixels.color[0], pixels.transmittance[0], pixels.depth[0])
        return score(seen, weight), (pixels, hits)

    motion, lists = listed(motion)
    asked, results = [], []
    for threads in (1, 2, 5):
        monkeypatch.setattr(cpu_march, "thread_count", lambda n=threads: asked.append(n) or n)
        # The number of threads is part of a program: each is of a function of its own.
        own = partial(jax.value_and_grad(loss, argnums=(0, 1), has_aux=True))
        results.append(jax.jit(own)(motion, lines, lists))
    assert set(asked) == {1, 2, 5}
    for other in results[1:]:
        assert all(
            np.array_equal(a, b)
            for a, b in zip(jax.tree.leaves(results[0]), jax.tree.leaves(other), strict=True)
        )


def test_many_calls_at_once_do_not_disturb_each_other():
    motion = beside(resting(gaussians(COUNT, **SIZES)), fleeting(COUNT, seed=3, **SIZES))
    weight, lines = weights(dtype=np.float32), shot(rays())

    def once(_):
        return jax.tree.map(np.asarray, jax.tree.leaves(pull(motion, lines, weight)))

    expected = once(0)
    with ThreadPoolExecutor(3) as pool:
        for found in pool.map(once, range(300)):
            assert all(map(np.array_equal, found, expected))


@pytest.mark.ci
def test_thousands_on_one_ray_are_all_met_in_their_order():
    count = 3_000
    motion, lines = pile(count)
    capacity = measure(motion, lines, options=OPTIONS)
    pixels, report = look(motion, lines, options=OPTIONS, capacity=capacity)
    assert int(report.dropped) == 0 and int(report.hits) > 0.99 * count * RAYS
    assert np.mean(np.abs(stacked(pixels) - stacked(reference.trace(motion, lines)))) < COLOR


def test_hundreds_on_one_ray_are_all_learnt_from():
    motion, _ = pile(150)
    color, errors = errors_on_device(motion, rays(place=(0, 0, -8), jitter=0.02, spread=0.01))
    assert color < COLOR and max(errors.values()) < GRADIENT, errors


def test_equal_distances_are_taken_in_the_order_of_the_list():
    lines = shot(rays(jitter=0.0))
    kernel, arrays = (
        look(
            resting(sheet(COUNT)),
            lines,
            options=replace(OPTIONS, backend=b),
            capacity=roomy(OPTIONS),
        )
        for b in ("kernel", "array")
    )
    np.testing.assert_allclose(stacked(kernel[0]), stacked(arrays[0]), atol=SINGLE)


def test_pictures_can_be_mapped_over():
    motion, lines = resting(gaussians(COUNT, **SIZES)), shot(rays())

    def seen(aside):
        moved = replace(lines, origin=lines.origin + aside[None])
        return look(motion, moved, options=OPTIONS, capacity=roomy(OPTIONS))[0].color

    aside = jnp.asarray([[0.0, 0, 0], [0.1, 0, 0]], jnp.float32)
    together = jax.vmap(seen)(aside)
    for one, x in zip(together, aside, strict=True):
        np.testing.assert_allclose(one, seen(x), atol=SINGLE)


@pytest.mark.parametrize("keys", [1, 3])
def test_a_scene_learns_the_same_if_rays_do_not_learn(monkeypatch, keys):
    motion = resting(gaussians(COUNT, degree=2, **SIZES)) if keys == 1 else mixed(keys)
    motion = beside(tinted(motion), fleeting(COUNT, degree=2, seed=3, **SIZES))
    lines, weight = shot(rays()), weights(dtype=np.float32)
    _, _, (expected, _) = pull(motion, lines, weight, capacity=roomy(OPTIONS))

    # Without the key times: what each ray sees of the key states depends on them.
    def learnt(motion):
        return motion.gaussians, motion.rest, motion.transient

    @jax.jit
    @jax.grad
    def slope(part):
        moved = eqx.tree_at(learnt, motion, part, is_leaf=lambda x: x is None)
        pixels, _ = trace(moved, lines, options=OPTIONS, capacity=roomy(OPTIONS))
        return score((pixels.color, pixels.transmittance, pixels.depth), weight)

    asked = []
    operands = cpu_march._operands
    monkeypatch.setattr(
        cpu_march, "_operands", lambda *given: asked.append(given[6:]) or operands(*given)
    )
    found = slope(learnt(motion))
    assert (False,) in asked and (True,) not in asked
    for own, other in zip(jax.tree.leaves(found), jax.tree.leaves(learnt(expected)), strict=True):
        largest = max(float(jnp.max(jnp.abs(other), initial=0)), 1.0)
        np.testing.assert_allclose(own, other, atol=SINGLE * largest)


def test_a_loss_of_colours_alone_has_gradients():
    motion, lines = resting(gaussians(COUNT, **SIZES)), shot(rays())
    weight = weights(dtype=np.float32).at[:, 3:].set(0)
    _, _, (expected, _) = pull(motion, lines, weight, capacity=roomy(OPTIONS))

    @jax.jit
    @jax.grad
    def slope(motion):
        pixels, _ = trace(motion, lines, options=OPTIONS, capacity=roomy(OPTIONS))
        return jnp.sum(weight[:, :3] * pixels.color)

    own = slope(motion).gaussians
    np.testing.assert_allclose(own.mean, expected.gaussians.mean, atol=SINGLE)
    np.testing.assert_allclose(own.opacity, expected.gaussians.opacity, atol=SINGLE)


def test_opacities_are_exponentials_but_for_roundings():
    @numba.njit
    def respond(block, opacity, alpha):
        cpu_meet.store_alphas(block, opacity, alpha)

    at, r = cpu_meet.AT_Q, np.random.default_rng(0)
    block, alpha = np.zeros(at + LANES, np.float32), np.zeros(LANES, np.float32)
    for largest in (1.0, 12.0, 170.0):
        q = r.uniform(0, largest, LANES).astype(np.float32)
        q[:2] = 0, largest
        block[at:] = q
        respond(block, np.float32(0.75), alpha)
        expected = 0.75 * np.exp(-q.astype(float) / 2)
        # One rounding of the result, and one of the exponent, which may be as large as `largest`.
        allowed = np.finfo(np.float32).eps * (2 + largest / 2)
        np.testing.assert_allclose(alpha, expected, rtol=allowed)
    block[at:] = np.inf
    respond(block, np.float32(0.75), alpha)
    assert np.all(alpha < 1e-37)


@pytest.mark.parametrize("count", [0, 1, 2, 3, 7, 64, 100, 201])
def test_every_lane_is_sorted(count):
    @numba.njit
    def sort(numbers, count):
        sort_lanes(numbers, count)

    # Many are equal, and rows behind the first ones stay as they are.
    numbers = np.random.default_rng(count).integers(0, 50, (count + 2, LANES))
    expected = np.concatenate([np.sort(numbers[:count], axis=0), numbers[count:]])
    sort(numbers, count)
    np.testing.assert_array_equal(numbers, expected)
