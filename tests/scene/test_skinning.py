"""Skinning in machine code on a CPU equals that by arrays in double precision, and so do all of its
gradients."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gaussray.scene.control_points import skinned


# Sums of up to 1,200 products of weights, whose exponents of up to 400 are rounded in single
# precision.
CLOSE = 1e-4
# Control points and Gaussians: one point, part of a vector, several vectors.
SIZES = [(1, 30), (7, 300), (70, 1200)]

on_cpu = pytest.mark.skipif(jax.default_backend() != "cpu", reason="arrays blend on a GPU")


def problem(points, count):
    """Places and radii of control points, places of Gaussians (one far from all), and a table."""
    dice = np.random.default_rng(points)
    position = dice.normal(size=(count, 3))
    position[0] = 6
    return (
        dice.normal(size=(points, 3)),
        dice.uniform(0.3, 0.8, points),
        position,
        dice.normal(size=(points, 16)),
    )


def cast(arrays, kind):
    return [jnp.asarray(x, kind) for x in arrays]


def gradients(arrays, wanted):
    weight = jnp.cos(jnp.arange(arrays[2].shape[0] * 16.0)).reshape(-1, 16).astype(arrays[0].dtype)

    def total(*arrays):
        return jnp.sum(skinned(*arrays) * weight)

    return jax.jit(jax.grad(total, argnums=wanted))(*arrays)


def assert_close(found, expected):
    assert found.dtype == jnp.float32
    off = np.abs(np.asarray(found, np.float64) - expected).max()
    assert off <= CLOSE * np.abs(expected).max()


@on_cpu
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("wanted", [(3,), (0, 1, 2, 3)])
def test_blends_and_gradients_equal_those_of_arrays(size, wanted):
    single, double = (cast(problem(*size), kind) for kind in (jnp.float32, jnp.float64))
    assert_close(jax.jit(skinned)(*single), skinned(*double))
    jax.tree.map(assert_close, gradients(single, wanted), gradients(double, wanted))


@on_cpu
def test_tables_of_several_times_share_the_weights_under_vmap():
    pivot, radius, position, table = cast(problem(7, 300), jnp.float32)
    tables = jnp.stack([table, 2 * table, table**2])
    found = jax.vmap(lambda own: skinned(pivot, radius, position, own))(tables)
    apart = [skinned(pivot, radius, position, own) for own in tables]
    np.testing.assert_array_equal(found, np.stack(apart))


@on_cpu
def test_a_place_that_is_not_a_number_spoils_its_own_blend_alone():
    pivot, radius, position, table = cast(problem(7, 300), jnp.float32)
    whole = np.asarray(skinned(pivot, radius, position, table))
    found = np.asarray(skinned(pivot, radius, position.at[7].set(jnp.nan), table))
    assert np.isnan(found[7]).all()
    np.testing.assert_array_equal(np.delete(found, 7, 0), np.delete(whole, 7, 0))


@on_cpu
@pytest.mark.parametrize("name", ["radius", "table"])
def test_arrays_of_another_number_of_points_are_refused(name):
    arrays = dict(zip(("pivot", "radius", "position", "table"), problem(7, 30), strict=True))
    arrays[name] = np.concatenate([arrays[name], arrays[name]])
    with pytest.raises((TypeError, ValueError)):
        skinned(*cast(arrays.values(), jnp.float32))


@on_cpu
def test_gradients_do_not_depend_on_the_threads(monkeypatch):
    from gaussray.scene import skinning_code

    arrays, found = cast(problem(70, 3000), jnp.float32), []
    for threads in (1, 3):
        monkeypatch.setattr(skinning_code, "thread_count", lambda threads=threads: threads)
        jax.clear_caches()
        found.append(gradients(arrays, (3,))[0])
    np.testing.assert_array_equal(*found)
