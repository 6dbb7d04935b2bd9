"""Products of plane samples by Numba on a CPU and by CUDA on a GPU equal those by arrays in double
precision, and so do their gradients."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gaussray.scene.planes import plane_product


# Six factors and their sums over up to 700 Gaussians, in single precision.
CLOSE = 5e-6
DEVICES = ["cpu", pytest.param("gpu", marks=pytest.mark.gpu)]
# Sides, channels, Gaussians: one vector of channels, none, some left over; all in one cell.
SIZES = [(16, 16, 700), (5, 3, 100), (33, 8, 257), (2, 1, 3)]


@pytest.fixture(params=DEVICES)
def device(request):
    if jax.default_backend() != request.param:
        pytest.skip(f"JAX runs on another device than {request.param}")
    return request.param


def problem(side, channels, count):
    """Planes, lines, positions (two of them at corners of the cube) and gradients of products."""
    dice = np.random.default_rng(side)
    unit = dice.uniform(0, 1, (count, 3))
    unit[:2] = (0, 1, 1), (1, 0, 0.5)
    return (
        dice.uniform(0.5, 1.5, (3, side, side, channels)),
        dice.uniform(0.5, 1.5, (3, side, channels)),
        unit,
        dice.normal(size=(count, channels)),
    )


def cast(arrays, kind):
    return [jnp.asarray(x, kind) for x in arrays]


def far_off(found, expected):
    """The largest difference, as a share of the largest value."""
    return np.abs(np.asarray(found, np.float64) - expected).max() / np.abs(expected).max()


def gradients(arrays, wanted=(0, 1, 2)):
    *inputs, weight = arrays

    def total(*inputs):
        return jnp.sum(plane_product(*inputs) * weight)

    return jax.jit(jax.grad(total, argnums=wanted))(*inputs)


@pytest.mark.parametrize("size", SIZES)
def test_products_and_their_gradients_equal_those_of_arrays(device, size):
    arrays = problem(*size)
    *inputs, _ = cast(arrays, jnp.float32)
    found = [jax.jit(plane_product)(*inputs), *gradients(cast(arrays, jnp.float32))]
    *inputs, _ = cast(arrays, jnp.float64)
    expected = [plane_product(*inputs), *gradients(cast(arrays, jnp.float64))]
    assert all(x.dtype == jnp.float32 for x in found)
    assert max(map(far_off, found, expected)) < CLOSE


def test_planes_alone_may_have_gradients(device):
    arrays = cast(problem(16, 16, 300), jnp.float32)
    (alone,) = gradients(arrays, (0,))
    assert far_off(alone, np.asarray(gradients(arrays)[0], np.float64)) < CLOSE


def test_many_lines_share_the_planes_under_vmap(device):
    space, line, unit, _ = cast(problem(16, 16, 300), jnp.float32)
    lines = jnp.stack([line, 2 * line, line**2])

    def squares(space):
        return jnp.sum(jax.vmap(lambda own: plane_product(space, own, unit))(lines) ** 2)

    def squares_of(space, own):
        return jnp.sum(plane_product(space, own, unit) ** 2)

    apart = np.sum([jax.grad(squares_of)(space, own) for own in lines], axis=0, dtype=np.float64)
    assert far_off(jax.grad(squares)(space), apart) < CLOSE


def test_a_position_that_is_not_a_number_spoils_its_own_products_alone(device):
    space, line, unit, _ = cast(problem(16, 16, 300), jnp.float32)
    whole = np.asarray(plane_product(space, line, unit))
    found = np.asarray(plane_product(space, line, unit.at[7].set(jnp.nan)))
    assert np.isnan(found[7]).all()
    np.testing.assert_array_equal(np.delete(found, 7, 0), np.delete(whole, 7, 0))


@pytest.mark.parametrize("side", [3, 9])
def test_lines_of_another_side_are_left_to_arrays(device, side):
    (space, _, unit, _), (_, line, _, _) = problem(5, 4, 50), problem(side, 4, 50)
    expected = plane_product(*cast((space, line, unit), jnp.float64))
    assert far_off(plane_product(*cast((space, line, unit), jnp.float32)), expected) < CLOSE


def test_gradients_do_not_depend_on_the_threads(monkeypatch):
    if jax.default_backend() != "cpu":
        pytest.skip("a GPU adds in no fixed order")
    from gaussray.scene import plane_code

    arrays, found = cast(problem(16, 16, 5000), jnp.float32), []
    for threads in (1, 3):
        monkeypatch.setattr(plane_code, "thread_count", lambda threads=threads: threads)
        jax.clear_caches()
        found.append(gradients(arrays))
    jax.tree.map(np.testing.assert_array_equal, *found)
