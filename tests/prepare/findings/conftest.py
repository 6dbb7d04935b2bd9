"""Fixtures of the tests of findings."""

import numpy as np
import pytest

from gaussray.prepare.placement import Placement
from gaussray.prepare.sparse_model import Observations, SparseModel


@pytest.fixture
def placement_of():
    """Makes a placement of pictures, none of which has a pose."""

    def make(pictures, still=frozenset()):
        nothing = np.zeros(0, int)
        seen = Observations(nothing, nothing, nothing, np.zeros((0, 2)), np.zeros(0))
        model = SparseModel([], np.zeros((0, 3, 4)), [], np.zeros((0, 3)), seen)
        return Placement(model, {p.file: p for p in pictures}, {}, {}, still, known=False)

    return make
