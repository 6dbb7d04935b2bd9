"""Transient Gaussians: their path, their window, and their place in a scene."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy
from jax.test_util import check_grads

from gaussray.scene.array_file import read_arrays, write_arrays
from gaussray.scene.formats.convert import export_model
from gaussray.scene.formats.gaussian_ply import read_gaussians
from gaussray.scene.point_tracks import FREE, group_of, point_path
from gaussray.scene.scene import at, key_count, transient_count
from gaussray.scene.segmented import Clip
from gaussray.scene.store import as_stored, load_scene, save_scene
from gaussray.scene.transient import (
    constrain_transients,
    interval_at,
    squared_age,
    transients_at,
    unconstrain_transients,
)


# Rounding of single precision, after a logarithm and an exponential.
ROUNDING = 1e-5


def scene():
    """What stands still, what moves, and what is there for a short time."""
    return replace(toy.scene(), transient=toy.transients())


def test_the_window_is_flat_and_then_a_gaussian():
    age = toy.single([-0.5, -0.3, -0.2, 0.0, 0.2, 0.4])
    s = squared_age(age, toy.single(1 / 0.1), toy.single(0.2))
    np.testing.assert_allclose(s, [9, 1, 0, 0, 0, 4], atol=ROUNDING)


def test_gaussians_are_displaced_by_their_velocity_and_dimmed_by_their_window():
    one = toy.transients(1)
    now = transients_at(one, one.instant[0] + 0.1)
    np.testing.assert_allclose(now.mean, one.mean + 0.1 * one.velocity, rtol=ROUNDING)
    window = np.exp(-0.5 * (0.1 / one.lifetime) ** 2)
    np.testing.assert_allclose(now.opacity, one.opacity * window, rtol=ROUNDING)


def test_the_derivative_of_the_window_is_that_of_finite_differences():
    x = jax.tree.map(lambda x: jnp.asarray(x, jnp.float64), toy.transients())
    names = ("instant", "lifetime", "velocity", "plateau")

    def seen(values, time):
        parts = dict(zip(names, map(jnp.asarray, values), strict=True))
        now = transients_at(replace(x, **parts), jnp.asarray(time))
        return now.mean, now.opacity

    values = tuple(getattr(x, name) for name in names)
    check_grads(seen, (values, jnp.asarray(0.6)), order=1, modes=["fwd", "rev"], eps=1e-6)


def test_unconstrained_values_are_the_same_gaussians_and_keep_the_floor_of_the_lifetime():
    x, shortest = toy.transients(), 0.02
    again = constrain_transients(unconstrain_transients(x, shortest), shortest)
    for a, b in zip(jax.tree.leaves(again), jax.tree.leaves(x), strict=True):
        np.testing.assert_allclose(a, b, rtol=ROUNDING)
    brief = replace(x, lifetime=jnp.full(5, 0.001))
    assert (constrain_transients(unconstrain_transients(brief, 0.02), 0.02).lifetime > 0.02).all()


def test_the_interval_at_an_instant_is_the_longer_one_beside_the_nearest_timestamp():
    # A picture is missing at 0.3; beyond the ends the nearest interval counts.
    times = toy.single([0.0, 0.1, 0.2, 0.4, 0.5])
    instant = toy.single([-1.0, 0.04, 0.1, 0.16, 0.2, 0.29, 0.31, 0.4, 0.44, 0.46, 2.0])
    expected = [0.1, 0.1, 0.1, 0.2, 0.2, 0.2, 0.2, 0.2, 0.2, 0.1, 0.1]
    np.testing.assert_allclose(interval_at(times, instant), expected, rtol=ROUNDING)
    np.testing.assert_array_equal(interval_at(times[:1], instant), np.ones(11))
    # A pause is no interval.
    pause = toy.single([0.0, 0.1, 0.2, 0.3, 9.0, 9.1])
    found = interval_at(pause, toy.single([0.1, 0.3, 5.0, 9.0]))
    np.testing.assert_allclose(found, [0.1, 0.2, 0.2, 0.2], rtol=ROUNDING)
    # Of two cameras that are not synchronised every second interval is short.
    found = interval_at(toy.single([0, 0.01, 0.1, 0.11, 0.2, 0.21]), toy.single([0.1, 0.15]))
    np.testing.assert_allclose(found, [0.09, 0.09], rtol=ROUNDING)


def test_a_floor_for_each_gaussian_is_kept_by_each():
    floor = toy.single([0.01, 0.02, 0.04, 0.05, 0.1])
    again = constrain_transients(unconstrain_transients(toy.transients(), floor), floor)
    expected = np.maximum(toy.transients().lifetime, 1.01 * floor)
    np.testing.assert_allclose(again.lifetime, expected, rtol=ROUNDING)


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
    assert key_count(replace(still, transient=toy.transients()), 1.0) == 1


def test_a_point_on_one_travels_at_its_velocity_and_belongs_to_what_moves():
    whole, time = scene(), toy.single(0.4)
    first = whole.static.count + whole.moving.count
    point = toy.single([1.0, 2.0, 3.0])
    for part in (whole, replace(whole, deformation=None)):
        path = point_path(part, jnp.asarray(first + 2), point, time)
        expected = point + 0.3 * whole.transient.velocity[2]
        np.testing.assert_allclose(path(toy.single(0.7)), expected, rtol=ROUNDING)
    still = point_path(whole, jnp.asarray(0), point, time)
    np.testing.assert_array_equal(still(toy.single(0.7)), point)
    groups = np.asarray(group_of(whole))
    assert len(groups) == whole.count and (groups[first:] == FREE).all()


@pytest.mark.parametrize("speed", [0.4, 0.0])
def test_a_file_holds_every_bit_and_an_old_reader_refuses_it(tmp_path, speed):
    whole = replace(toy.scene(speed=speed), transient=toy.transients())
    save_scene(tmp_path / "scene.npz", whole)
    found = load_scene(tmp_path)
    assert jax.tree.structure(found) == jax.tree.structure(whole)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(whole), strict=True):
        np.testing.assert_array_equal(a, b)
    with pytest.raises(ValueError, match="is of version 5, this gaussray reads 1 and 2"):
        read_arrays(tmp_path / "scene.npz", "gaussray-scene", 1, 2, 3, 4)


def test_a_clip_holds_those_of_each_segment(tmp_path):
    first, second = scene(), replace(toy.scene(), time_range=toy.single([1, 2]))
    save_scene(tmp_path / "scene.npz", Clip((first, second)))
    found = load_scene(tmp_path)
    assert isinstance(found, Clip) and found.segments[1].transient is None
    np.testing.assert_array_equal(found.segments[0].transient.velocity, first.transient.velocity)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("velocity", None, "'transient.velocity' is missing"),
        ("instant", np.zeros(4, np.float32), "'transient' differ in length"),
        ("lifetime", np.zeros(5, np.float32), "'transient.lifetime' must be above 0"),
    ],
)
def test_arrays_that_make_no_transients_are_refused_by_name(tmp_path, name, value, message):
    save_scene(tmp_path / "scene.npz", scene())
    header, array = read_arrays(tmp_path / "scene.npz", "gaussray-scene", 5)
    array = {k: x for k, x in (array | {f"transient.{name}": value}).items() if x is not None}
    write_arrays(tmp_path / "scene.npz", header, array)
    with pytest.raises(ValueError, match=message):
        load_scene(tmp_path)


def test_a_compact_file_is_off_by_half_a_step_and_loses_nothing_twice():
    whole = replace(scene(), transient=toy.transients(200))
    kept = as_stored(whole, precision="compact")
    again = as_stored(kept, precision="compact")
    for a, b in zip(jax.tree.leaves(again), jax.tree.leaves(kept), strict=True):
        np.testing.assert_array_equal(a, b)
    x, y = whole.transient, kept.transient
    row = np.abs(np.asarray(x.mean)[:, None] - np.asarray(y.mean)[None]).max(-1).argmin(axis=1)
    short, long = np.quantile(x.lifetime, [0.06, 0.95])
    step = np.quantile(np.min(np.asarray(x.scale), axis=1), 0.06) / 16
    assert sorted(row) == list(range(200))
    for name in ("instant", "plateau"):
        off = np.abs(np.asarray(getattr(x, name)) - np.asarray(getattr(y, name))[row])
        assert off.max() <= short / 64
    np.testing.assert_allclose(np.asarray(y.lifetime)[row], x.lifetime, rtol=0.006)
    # Off by no more than the mean itself, as long as they live.
    assert np.abs(np.asarray(x.velocity) - np.asarray(y.velocity)[row]).max() <= step / (4 * long)


def test_an_export_holds_those_that_are_alive_at_its_time(tmp_path):
    whole = scene()
    with pytest.raises(ValueError, match="time must be given"):
        export_model(replace(toy.scene(speed=0), transient=toy.transients()), tmp_path / "a.ply")
    written, _ = export_model(whole, tmp_path / "a.ply", 0.4, color="linear", degree=0)
    every = at(whole, toy.single(0.4))
    persistent = whole.static.count + whole.moving.count
    alive = (np.arange(every.count) < persistent) | (np.asarray(every.opacity) > 1 / 255)
    assert persistent < alive.sum() < every.count
    np.testing.assert_array_equal(written.mean, every.mean[alive])
    found = read_gaussians(tmp_path / "a.ply")
    np.testing.assert_allclose(found.opacity, every.opacity[alive], rtol=ROUNDING)
