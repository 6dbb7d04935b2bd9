"""Sample points: Sobol's, centred, repeatable, and different from pixel to pixel."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gaussray.camera.sampling import shifted_samples, sobol_samples, step_samples


def test_one_sample_is_the_centre():
    np.testing.assert_array_equal(sobol_samples(1), np.full((1, 5), 0.5))


@pytest.mark.parametrize("count", [2, 3, 5, 12, 16, 100, 256])
def test_points_fill_every_stratum_of_every_coordinate_once(count):
    expected = np.repeat((np.arange(count)[:, None] + 0.5) / count, 5, axis=1)
    np.testing.assert_allclose(np.sort(sobol_samples(count), axis=0), expected, atol=1e-12)


def test_the_points_are_those_of_joe_and_kuo():
    """The first eight points of five dimensions, from the direction numbers new-joe-kuo-6."""
    eighths = [
        [0, 0, 0, 0, 0], [4, 4, 4, 4, 4], [6, 2, 2, 2, 6], [2, 6, 6, 6, 2],
        [3, 3, 5, 7, 3], [7, 7, 1, 3, 7], [5, 1, 7, 5, 5], [1, 5, 3, 1, 1],
    ]  # fmt: skip
    np.testing.assert_array_equal(sobol_samples(8), (np.array(eighths) + 0.5) / 8)


def test_film_points_fill_every_elementary_square_once():
    """The first two coordinates form a (0, 2)-sequence: 4x4 cells hold one of 16 points each."""
    cell = np.floor(np.array(sobol_samples(16))[:, :2] * 4).astype(int)
    assert len({tuple(c) for c in cell}) == 16


@pytest.mark.parametrize("count", [6, 12, 100])
def test_any_count_is_better_spread_than_random_points(count):
    """Mean squares of what a plane through the cube cuts off, beside those of points at random."""
    dice, points = np.random.default_rng(0), np.array(sobol_samples(count))
    normals = dice.normal(size=(500, 5))
    many = dice.uniform(size=(20_000, 5))

    def error(some):
        shares = [np.mean((x - 0.5) @ normals.T > 0.3, axis=0) for x in (some, many)]
        return np.mean((shares[0] - shares[1]) ** 2)

    assert error(points) < 0.5 * np.mean([error(dice.uniform(size=(count, 5))) for _ in range(20)])


def test_no_samples_are_refused():
    with pytest.raises(ValueError, match="samples must be at least 1, got 0"):
        sobol_samples(0)


def test_a_sharp_step_looks_through_the_centre():
    np.testing.assert_array_equal(step_samples(1, jnp.asarray(7)), np.full((1, 5), 0.5))


def test_steps_fill_the_cube_evenly_together():
    """Of 256 steps with 4 points each, every eighth of every coordinate holds an eighth, and every
    pair of coordinates fills 8 x 8 cells; shifts drawn at random would leave a root of the count
    more or less."""
    steps = jnp.arange(256) + 100_000
    points = np.array(jax.vmap(lambda s: step_samples(4, s))(steps)).reshape(-1, 5)
    assert (points >= 0).all() and (points < 1).all()
    share = [np.histogram(x, 8, (0, 1))[0] / len(points) for x in points.T]
    np.testing.assert_allclose(share, 1 / 8, atol=0.01)
    for i in range(5):
        for j in range(i):
            cells = np.histogram2d(points[:, i], points[:, j], 8, ((0, 1), (0, 1)))[0]
            assert cells.min() > 0


def test_batches_are_points_of_their_own_that_stay_spread():
    draw = jax.jit(jax.vmap(lambda batch: shifted_samples(16, batch)))
    points = np.array(draw(jnp.arange(2000)))
    assert (points >= 0).all() and (points < 1).all()
    gaps = np.diff(np.sort(points, axis=1), axis=1)
    np.testing.assert_allclose(gaps, 1 / 16, atol=1e-12)
    first = points[:, 0]
    # 2000 uniform draws: deviations 0.29 / 45 of the mean, 1 / 45 of a correlation.
    np.testing.assert_allclose(first.mean(axis=0), 0.5, atol=0.026)
    assert np.abs(np.corrcoef(first.T) - np.eye(5)).max() < 0.09
    assert np.abs(np.corrcoef(first[:-1, 0], first[1:, 0])[0, 1]) < 0.09


@pytest.mark.parametrize("count, gain", [(64, 1.3), (1024, 1.7)])
def test_a_moving_edge_out_of_focus_has_less_error_than_with_random_points(count, gain):
    """A pixel with all five dimensions in it: measured, the root mean square error of random points
    is 1.9 and 2.4 times as large."""
    rng = np.random.default_rng(0)

    def light(u):
        x = u[..., 0] + 1.5 * np.sqrt(u[..., 2]) * np.cos(2 * np.pi * u[..., 3]) + 0.8 * u[..., 4]
        y = u[..., 1] + 1.5 * np.sqrt(u[..., 2]) * np.sin(2 * np.pi * u[..., 3])
        return np.mean(0.8 * x + 0.6 * y > 0.9, axis=-1)

    draw = jax.jit(jax.vmap(lambda batch: shifted_samples(count, batch)))
    ours = light(np.asarray(draw(jnp.arange(300))))
    random = light(rng.random((300, count, 5)))
    assert np.std(random) > gain * np.std(ours)
    error = np.hypot(np.std(ours), np.std(random)) / np.sqrt(300)
    np.testing.assert_allclose(ours.mean(), random.mean(), atol=4 * error)
