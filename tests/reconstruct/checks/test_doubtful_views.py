"""Training pictures that the scene stays far from are named, the worst first."""

import numpy as np
import pytest

from gaussray.reconstruct.checks.doubtful_views import doubtful_views


NAMES = [f"p{k}" for k in range(10)]


def errors(**odd):
    error = np.linspace(0.02, 0.04, 10)
    for name, value in odd.items():
        error[NAMES.index(name)] = value
    return np.repeat(error[:, None], 4, axis=1)


def test_pictures_far_from_the_scene_are_named_with_the_worst_first():
    line = doubtful_views(NAMES, errors(p3=0.2, p7=0.3))
    assert line.startswith("2 of 10 training pictures") and ": p7, p3. " in line
    assert "capture.test=['p7']" in line


def test_of_many_the_worst_are_named_and_the_others_counted():
    names = [f"q{k}" for k in range(30)]
    error = np.full((30, 4), 0.01)
    error[:9] = np.linspace(0.2, 0.1, 9)[:, None]
    line = doubtful_views(names, error)
    assert "q0, q1, q2, q3, q4, q5 and 3 others." in line


@pytest.mark.parametrize("count", [7, 10])
def test_nothing_is_said_of_few_pictures_or_of_alike_ones(count):
    assert doubtful_views(NAMES, errors()) == ""
    short = doubtful_views(NAMES[:count], errors(p3=0.5)[:count])
    assert bool(short) == (count == 10)


def test_tiles_that_were_never_drawn_say_nothing_of_a_picture():
    # One tile of p1 is bad, half of p2 is masked, nearly nothing of p5 was drawn.
    error = np.full((10, 8), 0.02)
    error[1, 0], error[2, 4:], error[5, 0], error[5, 1:], error[8] = 0.1, np.nan, 0.9, np.nan, 0.2
    line = doubtful_views(NAMES, error)
    assert line.startswith("1 of the 9 training pictures that were compared stay")
    assert ": p8. " in line
