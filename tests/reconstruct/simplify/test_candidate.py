"""What is taken from a candidate is missing, what does nothing goes, and nothing else changes."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.reconstruct.simplify.candidate import (
    at_time,
    begin_candidate,
    in_shape_of,
    whole_candidate,
    with_degree,
    without_change_in_time,
    without_head,
    without_scale,
)
from gaussray.reconstruct.simplify.finished import finished_scene
from gaussray.scene.bodies import Bodies
from gaussray.scene.deformation import initial_deformation
from gaussray.scene.harmonics import constant_harmonics
from gaussray.scene.planes import features, initial_planes
from gaussray.scene.scene import Scene, at
from gaussray.scene.spare_rows import enlarged


# Sums of a few dozen numbers near 1 in single precision.
CLOSE = {"rtol": 2e-5, "atol": 2e-5}
TIMES = np.linspace(0, 1, 3)
shown = jax.jit(at)
traced = jax.jit(at_time)


@pytest.fixture(scope="module")
def scene():
    """A wall, two Gaussians that move by every part of a field of two scales, and a body that
    holds one of them."""
    keys = jax.random.split(jax.random.key(0), 3)
    planes = initial_planes(
        keys[0], toy.single([-1, -1, -1]), toy.single([1, 1, 1]), (0.0, 1.0),
        sides=(4, 5), instants=3, channels=4,
    )  # fmt: skip
    turn = np.tile(toy.single([1, 0, 0, 0]), (2, 3, 1)) + 0.1 * np.arange(24).reshape(2, 3, 4)
    path = 0.1 * np.arange(18).reshape(2, 3, 3)
    bodies = Bodies(*map(toy.single, ([[-0.4, -0.2, 0], [9, 9, 9]], [0.2, 0.1], TIMES, path, turn)))
    field = initial_deformation(keys[1], planes, bodies, width=8)
    leaves, tree = jax.tree.flatten((field.planes.time, field.mean, field.rotation, field.scale,
                                     field.tint))  # fmt: skip
    noise = jax.random.split(keys[2], len(leaves))
    leaves = [
        x + 0.1 * jax.random.normal(k, x.shape, x.dtype) for x, k in zip(leaves, noise, strict=True)
    ]
    names = ("mean", "rotation", "scale", "tint")
    time, *heads = jax.tree.unflatten(tree, leaves)
    field = eqx.tree_at(lambda d: d.planes.time, field, time)
    field = dataclasses.replace(field, **dict(zip(names, heads, strict=True)))
    one = toy.scene(speed=1.0)
    color = constant_harmonics(one.moving.harmonics[:, 0] * 0.1 + 0.5, 1)
    moving = dataclasses.replace(one.moving, harmonics=color.at[:, 1:].set(0.2))
    return Scene(one.static, moving, field, one.time_range)


def assert_alike(found, wanted, rows=slice(None)):
    """Equal Gaussians, whatever their number of harmonics that are zero."""
    for name in ("mean", "quat", "scale", "opacity", "tint"):
        np.testing.assert_allclose(getattr(found, name), getattr(wanted, name)[rows], **CLOSE)
    shorter = found.harmonics.shape[1]
    np.testing.assert_allclose(found.harmonics, wanted.harmonics[rows][:, :shorter], **CLOSE)
    assert not np.any(wanted.harmonics[rows][:, shorter:])


@pytest.mark.parametrize("time", [0.0, 0.3, 1.0])
def test_a_candidate_of_everything_is_the_scene_at_every_time(scene, time):
    candidate, _ = begin_candidate(scene, TIMES)
    assert_alike(traced(candidate, toy.single(time)), shown(scene, toy.single(time)))
    assert_alike(shown(finished_scene(candidate), toy.single(time)), shown(scene, toy.single(time)))


def test_bodies_that_hold_nothing_go(scene):
    bodies = finished_scene(whole_candidate(scene)).deformation.bodies
    np.testing.assert_array_equal(bodies.pivot, scene.deformation.bodies.pivot[:1])
    np.testing.assert_array_equal(bodies.turn, scene.deformation.bodies.turn[:1])


def test_what_is_not_kept_is_too_faint_to_be_met_and_then_gone(scene):
    candidate, _ = begin_candidate(scene, TIMES)
    gone = np.array([0, 7, 26])
    candidate = eqx.tree_at(lambda d: d.kept, candidate, candidate.kept.at[gone].set(False))
    found, wanted = (f(x, toy.single(0.3)) for f, x in ((traced, candidate), (shown, scene)))
    assert np.all(np.asarray(found.opacity)[gone] < 1e-10)
    rest = np.delete(np.arange(27), gone)
    np.testing.assert_array_equal(found.opacity[rest], wanted.opacity[rest])
    finished = finished_scene(candidate)
    assert (finished.static.count, finished.moving.count) == (23, 1)
    assert_alike(shown(finished, toy.single(0.3)), wanted, rest)


def test_at_rest_it_is_in_the_mean_of_its_states(scene):
    candidate, change = begin_candidate(scene, TIMES)
    states = [shown(scene, toy.single(time)) for time in TIMES]
    candidate = eqx.tree_at(lambda d: d.resting, candidate, candidate.resting.at[0].set(True))
    finished = finished_scene(candidate)
    assert (finished.static.count, finished.moving.count) == (26, 1)
    for time in (0.0, 0.7):
        found, drawn = (f(x, toy.single(time)) for f, x in ((shown, finished), (traced, candidate)))
        mean = np.mean([x.mean[25] for x in states], axis=0)
        np.testing.assert_allclose(found.mean[25], mean, **CLOSE)
        scale = np.exp(np.mean([np.log(x.scale[25]) for x in states], axis=0))
        np.testing.assert_allclose(found.scale[25], scale, **CLOSE)
        np.testing.assert_allclose(found.mean, drawn.mean, **CLOSE)
        # Its mean tint is in its harmonics: (1/2 + sum c Y) tint, here of the constant one.
        tint = np.exp(np.mean([np.log(x.tint[25]) for x in states], axis=0))
        light = (0.5 + 0.28209479 * scene.moving.harmonics[0, 0]) * tint
        np.testing.assert_allclose(0.5 + 0.28209479 * found.harmonics[25, 0], light, **CLOSE)
    distance = [np.linalg.norm(x.mean[25] - mean) for x in states]
    assert change[0] >= np.max(distance) / scale.max() - CLOSE["atol"]


def test_change_is_the_largest_of_path_axes_and_light():
    # Half of its size of 0.2 to either side of the middle, and nothing else.
    one = toy.scene(speed=0.2)
    field = one.deformation
    ramp = jnp.asarray([0.0, 0.5, 1.0], jnp.float32)
    path = jnp.zeros_like(field.bodies.path).at[0, :, 0].set(0.2 * ramp)
    still = eqx.tree_at(lambda d: d.mean[1], field, jax.tree.map(jnp.zeros_like, field.mean[1]))
    moved = eqx.tree_at(lambda d: d.bodies.path, still, path)
    _, change = begin_candidate(dataclasses.replace(one, deformation=moved), TIMES)
    np.testing.assert_allclose(change, 0.5, **CLOSE)
    turned = eqx.tree_at(lambda d: d.tint[1].bias, still, toy.single([0.3, 0, 0]))
    _, change = begin_candidate(dataclasses.replace(one, deformation=turned), TIMES)
    np.testing.assert_allclose(change, 0, **CLOSE)


def test_when_nothing_moves_there_is_no_deformation(scene):
    candidate, _ = begin_candidate(scene, TIMES)
    candidate = eqx.tree_at(lambda d: d.resting, candidate, jnp.ones(2, bool))
    finished = finished_scene(candidate)
    assert finished.deformation is None and finished.moving.count == 0
    assert finished.static.count == 27


def test_a_head_that_is_taken_away_adds_nothing(scene):
    candidate = whole_candidate(scene)
    without = without_head(candidate, "mean")
    finished = finished_scene(without)
    assert finished.deformation.mean is None and finished.deformation.tint is not None
    assert_alike(shown(finished, toy.single(0.3)), traced(without, toy.single(0.3)))
    before = traced(candidate, toy.single(0.3))
    np.testing.assert_array_equal(traced(without, toy.single(0.3)).scale, before.scale)
    assert np.abs(traced(without, toy.single(0.3)).mean - before.mean)[25:].max() > 1e-3


def test_without_heads_bodies_still_move_and_the_field_is_gone(scene):
    candidate = whole_candidate(scene)
    for head in ("mean", "rotation", "scale", "tint"):
        candidate = without_head(candidate, head)
    finished = finished_scene(candidate)
    field = finished.deformation
    assert field.planes.space == () and field.trunk.weight.size == 0
    assert sum(x.size for x in jax.tree.leaves((field.planes.time, field.trunk))) == 0
    assert_alike(shown(finished, toy.single(0.7)), traced(candidate, toy.single(0.7)))
    held = [shown(finished, toy.single(time)).mean[25] for time in (0.0, 1.0)]
    assert np.abs(held[1] - held[0]).max() > 0.1


@pytest.mark.parametrize("scale", [0, 1])
def test_a_scale_is_replaced_by_its_mean(scene, scale):
    candidate = without_scale(whole_candidate(scene), scale, TIMES)
    finished = finished_scene(candidate)
    field, old = finished.deformation, scene.deformation
    assert len(field.planes.space) == 1
    np.testing.assert_array_equal(field.planes.space[0], old.planes.space[1 - scale])
    place = scene.moving.mean
    own = slice(4 * scale, 4 * scale + 4)
    every = [features(old.planes, place, toy.single(time)) for time in TIMES]
    mean = np.mean([x[:, own] for x in every], axis=(0, 1))
    hidden = every[1].at[:, own].set(mean[None]) @ old.trunk.weight + old.trunk.bias[None]
    found = field.trunk(features(field.planes, place, toy.single(TIMES[1])))
    np.testing.assert_allclose(found, hidden, **CLOSE)
    assert_alike(shown(finished, toy.single(0.3)), traced(candidate, toy.single(0.3)))


def test_a_time_plane_that_is_steady_is_kept_as_one_row(scene):
    candidate = without_change_in_time(whole_candidate(scene), 1)
    finished = finished_scene(candidate)
    time = finished.deformation.planes.time
    assert [x.shape[1] for x in time] == [3, 1]
    mean = scene.deformation.planes.time[1].mean(axis=1, keepdims=True)
    np.testing.assert_allclose(time[1], mean, **CLOSE)
    for moment in (0.0, 0.3, 1.0):
        assert_alike(shown(finished, toy.single(moment)), traced(candidate, toy.single(moment)))


def test_degrees_are_lowered_of_one_kind_alone(scene):
    candidate, _ = begin_candidate(scene, TIMES)
    candidate = eqx.tree_at(lambda d: d.resting, candidate, candidate.resting.at[0].set(True))
    lowered = {
        part: finished_scene(with_degree(candidate, part, 0)) for part in ("static", "moving")
    }
    counts = {
        p: (x.static.harmonics.shape[1], x.moving.harmonics.shape[1]) for p, x in lowered.items()
    }
    # One that came to rest brings its degree along.
    assert counts == {"static": (1, 4), "moving": (4, 1)}


def test_a_scene_in_the_shape_of_a_candidate_is_the_scene(scene):
    padded = enlarged(scene.static, scene.static.count + 3)
    more = np.pad(padded.harmonics, ((0, 0), (0, 3), (0, 0)))
    like = dataclasses.replace(
        scene,
        static=dataclasses.replace(padded, harmonics=jnp.asarray(more)),
        moving=enlarged(scene.moving, scene.moving.count + 2),
        transient=enlarged(toy.transients(), 9),
    )
    stored = dataclasses.replace(scene, transient=toy.transients())
    found = in_shape_of(whole_candidate(like), stored)
    assert jax.tree.map(np.shape, found) == jax.tree.map(np.shape, whole_candidate(like))
    ended = finished_scene(found)
    assert_alike(shown(ended, toy.single(0.3)), shown(stored, toy.single(0.3)))
    assert ended.transient.count == toy.transients().count


def test_a_scene_too_large_for_the_shape_keeps_its_own(scene):
    small = dataclasses.replace(scene, static=jax.tree.map(lambda x: x[:1], scene.static))
    assert scene.static.count > 1
    assert in_shape_of(whole_candidate(small), scene).scene.static.count == scene.static.count
