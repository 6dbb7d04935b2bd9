"""Draws follow their distributions, and depend on their own name alone."""

import re

import numpy as np
import pytest
from scipy import stats

from gaussray.render.randomize.distributions import (
    draw_value,
    draw_values,
    read_distributions,
    uniform_number,
)


# Kolmogorov and Smirnov: chance exceeds this p-value of a wrong distribution with certainty, and
# the draws are always the same.
CHANCE = 1e-3
COUNT = 2000


def sampled(spec, key="x"):
    """The value of a distribution at many indices."""
    of = read_distributions({key: spec})
    return [draw_values(0, index, 0, of)[key] for index in range(COUNT)]


def at(u):
    return lambda _: u


def test_a_number_is_that_of_seed_index_attempt_and_key():
    # 52 bits of `printf 7/3/0/aperture.radius | sha256sum`, in the middle of their cell.
    assert uniform_number(7, 3, 0, "aperture.radius") == (0x903A766196382 + 0.5) / 2**52
    near = [(7, 3, 0, "k"), (8, 3, 0, "k"), (7, 4, 0, "k"), (7, 3, 1, "k"), (7, 3, 0, "l")]
    assert len({uniform_number(*names) for names in near}) == len(near)
    numbers = [uniform_number(0, index, 0, "x") for index in range(COUNT)]
    assert 0 < min(numbers) and max(numbers) < 1
    assert stats.kstest(numbers, "uniform").pvalue > CHANCE
    assert abs(np.corrcoef(numbers[1:], numbers[:-1])[0, 1]) < 3 / COUNT**0.5


@pytest.mark.parametrize(
    ("spec", "law"),
    [
        ({"uniform": [-2.0, 3.0]}, stats.uniform(-2, 5)),
        ({"log_uniform": [0.01, 10.0]}, stats.loguniform(0.01, 10)),
        ({"normal": [1.0, 0.5]}, stats.norm(1, 0.5)),
        ({"normal": [1.0, 0.5], "within": [0.8, 3.0]}, stats.truncnorm(-0.4, 4, 1, 0.5)),
        # Both tails of the bell, where it is 1e-15 of it.
        ({"normal": [0.0, 1.0], "within": [8.0, 9.0]}, stats.truncnorm(8, 9)),
        ({"normal": [0.0, 1.0], "within": [-9.0, -8.0]}, stats.truncnorm(-9, -8)),
    ],
)
def test_draws_follow_the_distribution(spec, law):
    assert stats.kstest(sampled(spec), law.cdf).pvalue > CHANCE


def test_counts_of_whole_numbers_and_choices_are_what_their_shares_say():
    found = sampled({"integer": [3, 6]})
    assert set(map(type, found)) == {int}
    assert stats.chisquare(np.unique(found, return_counts=True)[1]).pvalue > CHANCE
    assert set(found) == {3, 4, 5, 6}
    found = sampled({"choice": ["a", "b", "c"], "weights": [1, 0, 3]})
    assert set(found) == {"a", "c"}
    assert stats.binomtest(found.count("a"), COUNT, 0.25).pvalue > CHANCE


@pytest.mark.parametrize("u", [0.5**53, 1 - 0.5**53])
def test_the_ends_belong_to_what_is_drawn(u):
    # So close to 0 and 1 that products round.
    low, high = (0, 1) if u < 0.5 else (1, 0)
    for spec in ({"uniform": [0.1, 0.3]}, {"log_uniform": [0.1, 0.3]}):
        assert 0.1 <= draw_value(spec, at(u), "x") <= 0.3
    assert draw_value({"integer": [2, 4]}, at(u), "x") == (2, 4)[low]
    assert draw_value({"choice": ["a", "b"]}, at(u), "x") == "ab"[low]
    bell = {"normal": [0.0, 1.0], "within": [-1.0, 1.0]}
    assert draw_value(bell, at(u), "x") == pytest.approx((-1.0, 1.0)[low], abs=1e-12)
    assert draw_value({"normal": [2.0, 0.0]}, at(u), "x") == 2.0
    assert draw_value({"uniform": [5.0, 5.0]}, at(u), "x") == 5.0 and high in (0, 1)


def test_elements_of_a_list_are_drawn_each_on_their_own():
    each = {"each": [{"uniform": [0.0, 1.0]}, 0.5, {"uniform": [0.0, 1.0]}]}
    found = np.array(sampled(each))
    assert set(found[:, 1]) == {0.5}
    assert abs(np.corrcoef(found[:, 0], found[:, 2])[0, 1]) < 3 / COUNT**0.5


def test_a_draw_knows_nothing_of_other_keys_and_of_their_order():
    a, b = {"uniform": [0.0, 1.0]}, {"normal": [0.0, 1.0]}
    both = draw_values(1, 5, 0, read_distributions({"lens": {"fov": a, "k": b}}))
    assert draw_values(1, 5, 0, read_distributions({"lens": {"k": b, "fov": a}})) == both
    assert (
        draw_values(1, 5, 0, read_distributions({"lens": {"fov": a}}))["lens.fov"]
        == both["lens.fov"]
    )


def test_a_tree_is_read_by_its_keys_and_a_group_may_have_keys_beside_its_choice():
    tree = {
        "lens": {"choice": ["fisheye", "pinhole"], "fov": {"uniform": [60, 90]}},
        "aperture": {"radius": {"choice": [0.1], "weights": [1]}},
        "fps": {"integer": [8, 24]},
    }
    assert read_distributions(tree) == {
        "lens": {"choice": ["fisheye", "pinhole"]},
        "lens.fov": {"uniform": [60, 90]},
        "aperture.radius": {"choice": [0.1], "weights": [1]},
        "fps": {"integer": [8, 24]},
    }
    assert read_distributions({}) == {}


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        (
            0.1,
            "sample.x must be a distribution, such as uniform: [0, 1] or choice: [a, b], got 0.1",
        ),
        ({"uniform": [2, 1]}, "sample.x.uniform must be two numbers, the lower one first"),
        ({"uniform": [1]}, "sample.x.uniform must be two numbers, the lower one first, got [1]"),
        ({"uniform": [0, float("nan")]}, "sample.x.uniform must be two numbers"),
        ({"uniform": ["a", "b"]}, "sample.x.uniform must be two numbers"),
        ({"log_uniform": [0, 1]}, "sample.x.log_uniform must be two numbers above 0"),
        ({"integer": [0, 1.5]}, "sample.x.integer must be two whole numbers"),
        ({"normal": [0, -1]}, "sample.x.normal must be a mean, and a deviation of at least 0"),
        ({"normal": [0, 1], "within": [50, 60]}, "sample.x.within must hold a part of the bell"),
        ({"normal": [0, 0], "within": [1, 2]}, "sample.x.within must hold a part of the bell"),
        ({"normal": [0, 1], "within": [2]}, "sample.x.within must be two numbers"),
        ({"choice": []}, "sample.x.choice must be a list of at least one value"),
        ({"choice": [1, 2], "weights": [1]}, "sample.x.weights must be 2 numbers of at least 0"),
        ({"choice": [1, 2], "weights": [0, 0]}, "one for each choice and not all 0"),
        ({"uniform": [0, 1], "weights": [1]}, "sample.x.weights is unknown; beside uniform"),
        ({"uniform": [0, 1], "normal": [0, 1]}, "remove the others, e.g. ~sample.x.uniform"),
        ({"each": [{"uniform": [1, 0]}]}, "sample.x.each.0.uniform must be two numbers"),
        ({"each": [{"mean": {"uniform": [0, 1]}}]}, "sample.x.each must be a list of"),
    ],
)
def test_what_is_no_distribution_is_refused_by_its_key(spec, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        read_distributions({"x": spec})
