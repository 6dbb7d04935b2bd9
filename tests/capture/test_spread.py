"""A few of many: the first and the last, and the same distance between neighbours."""

import numpy as np
import pytest

from gaussray.capture.spread import evenly_spread, spread_indices


@pytest.mark.parametrize("length", [1, 2, 7, 100])
@pytest.mark.parametrize("count", [1, 2, 5, 7, 60])
def test_as_many_as_asked_for_lie_at_even_distances_to_half_an_index(length, count):
    found = spread_indices(length, count)
    assert len(found) == min(length, count) and found[0] == 0
    assert len(set(found.tolist())) == len(found)
    if len(found) > 1:
        assert found[-1] == length - 1
        exact = np.arange(len(found)) * (length - 1) / (len(found) - 1)
        assert np.abs(found - exact).max() <= 0.5


def test_items_are_those_of_the_indices():
    assert evenly_spread("abcdefghi", 3) == ["a", "e", "i"]
    assert evenly_spread("ab", 3) == ["a", "b"] and evenly_spread("", 3) == []
    assert evenly_spread("ab", 0) == []
