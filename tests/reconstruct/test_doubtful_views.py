"""Training pictures that the scene stays far from are named, the worst first."""

import numpy as np
import pytest

from gaussray.reconstruct.doubtful_views import doubtful_sentence


NAMES = [f"p{k}" for k in range(10)]


def errors(**odd):
    error = np.linspace(0.02, 0.04, 10)
    for name, value in odd.items():
        error[NAMES.index(name)] = value
    return error


def test_pictures_far_from_the_scene_are_named_with_the_worst_first():
    line = doubtful_sentence(NAMES, errors(p3=0.2, p7=0.3))
    assert line.startswith("2 of 10 training pictures") and ": p7, p3. " in line
    assert "capture.test=['p7']" in line


def test_of_many_the_worst_are_named_and_the_others_counted():
    names = [f"q{k}" for k in range(30)]
    error = np.full(30, 0.01)
    error[:9] = np.linspace(0.2, 0.1, 9)
    line = doubtful_sentence(names, error)
    assert "q0, q1, q2, q3, q4, q5 and 3 more." in line


@pytest.mark.parametrize("count", [7, 10])
def test_nothing_is_said_of_few_pictures_or_of_alike_ones(count):
    assert doubtful_sentence(NAMES, errors()) == ""
    short = doubtful_sentence(NAMES[:count], errors(p3=0.5)[:count])
    assert bool(short) == (count == 10)
