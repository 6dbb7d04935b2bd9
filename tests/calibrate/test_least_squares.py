"""Robust least squares: what a step does, how far answers scatter, what undoes what."""

import numpy as np

from gaussray.calibrate.least_squares import (
    correlated_pairs,
    covariance,
    huber,
    marquardt_step,
    robust_deviation,
)


# Rounding of double precision, where numbers differ in size by ten million.
SAME = 1e-7
# The deviation of 300 draws is uncertain by 4 %; three times that.
DRAWS, SCATTER = 300, 0.12


def test_a_step_without_damping_solves_a_linear_problem():
    rng = np.random.default_rng(0)
    columns, truth = rng.standard_normal((30, 4)) * [1, 10, 1e-3, 1e4], rng.standard_normal(4)
    residual = -columns @ truth
    found = marquardt_step(columns.T @ columns, columns.T @ residual, 0.0)
    np.testing.assert_allclose(found, truth, rtol=SAME)


def test_what_no_picture_tells_stays():
    curvature = np.diag([4.0, 0.0])
    np.testing.assert_array_equal(marquardt_step(curvature, np.array([2.0, 0.0]), 0.0), [-0.5, 0])


def test_hubers_loss_is_a_parabola_that_goes_on_straight():
    np.testing.assert_allclose(huber(np.array([0.5, -3.0]), 2.0), 0.125 + 2 * 3 - 2)


def test_outliers_hardly_change_the_spread():
    error = np.random.default_rng(1).standard_normal(10_000)
    error[:300] = 1e3
    assert abs(robust_deviation(error) - 1) < 0.06


def drawn(noise, bend):
    """Answers of robust fits to drawn errors, and the deviations that each fit states: of errors
    that are independent, and alike within fours."""
    rng = np.random.default_rng(2)
    columns = rng.standard_normal((200, 2)) + [0.0, 2.0]
    answers, stated = [], []
    for _ in range(DRAWS):
        error, value = noise(rng), np.zeros(2)
        for _ in range(6):
            residual = columns @ value - error
            weight = np.minimum(1, bend / np.maximum(np.abs(residual), 1e-12))
            inner = (np.abs(residual) < bend).astype(float)
            own = columns * (weight * residual)[:, None]
            value = value + marquardt_step((columns.T * weight) @ columns, own.sum(axis=0), 0.0)
        together = own.reshape(50, 4, 2).sum(axis=1)
        curvature = (columns.T * inner) @ columns
        both = [covariance(curvature, x.T @ x) for x in (own, together)]
        answers.append(value)
        stated.append([np.sqrt(np.diag(c)) for c in both])
    return np.std(answers, axis=0), np.sqrt(np.mean(np.square(stated), axis=0))


def test_stated_errors_are_those_of_repeated_noise():
    scatter, (independent, together) = drawn(lambda rng: rng.standard_normal(200), 1.345)
    np.testing.assert_allclose(independent / scatter, 1, atol=SCATTER)
    np.testing.assert_allclose(together / scatter, 1, atol=SCATTER)


def test_errors_that_hang_together_are_stated_by_their_sums():
    scatter, (independent, together) = drawn(
        lambda rng: np.repeat(rng.standard_normal(50), 4), 1.345
    )
    # Fifty sums of two numbers: the stated variance is low by about their ratio.
    np.testing.assert_allclose(together / scatter, 1, atol=2 * SCATTER)
    assert independent[1] < 0.75 * scatter[1]


def test_two_numbers_that_do_the_same_are_named():
    first, second, third = np.linalg.qr(np.random.default_rng(3).standard_normal((1000, 3)))[0].T
    columns = np.stack([first, second, first + 0.1 * third], axis=1) * [1, 7, 1e3]
    ((i, j, correlation),) = correlated_pairs(columns.T @ columns, 0.98)
    assert (i, j) == (0, 2)
    np.testing.assert_allclose(correlation, -1 / np.sqrt(1.01), rtol=SAME)
    assert correlated_pairs(np.diag([1.0, 2.0, 3.0]), 0.98) == []


def test_what_cannot_be_known_has_a_large_error_not_a_small_one():
    columns = np.ones((10, 2))
    error = np.sqrt(np.diag(covariance(columns.T @ columns, columns.T @ columns)))
    assert error.min() > 100
