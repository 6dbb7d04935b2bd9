"""What is told of a case, and how far its inputs' own rounding moves it."""

from typing import NamedTuple

import jax
import numpy as np


# Mean absolute colour, as in tests/tracer/test_extremes.py; gradients relative to the largest.
COLOR, GRADIENT = 1e-4, 1e-3
# Half a unit of the last place, by which inputs are moved so often, as in that test.
HALF_ULP, DRAWS = 2.0**-24, 4


class Outcome(NamedTuple):
    """A figure of a case, and the most it may be."""

    case: str
    figure: str
    value: float
    limit: float

    @property
    def held(self) -> bool:
        return bool(self.value <= self.limit)


def nudged(tree, seed=0):
    """Every number half a unit of float32 away, in double precision."""
    dice = np.random.default_rng(seed)

    def move(x):
        x = np.asarray(x, np.float64)
        return x * (1 + HALF_ULP * dice.choice([-1.0, 1.0], x.shape))

    return jax.tree.map(move, tree)
