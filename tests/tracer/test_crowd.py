"""Thousands of Gaussians: against brute force, and on a single ray."""

import numpy as np
import pytest
from pictures import seen_through
from scenes import RAYS, against_brute_force, gaussians, padded, rays, resting

from gaussray.tracer.options import TraceOptions
from gaussray.tracer.traverse import Capacity


# Asked of single precision: mean absolute colour, and gradients relative to the largest.
COLOR, GRADIENT = 1e-4, 1e-3
# Ten thousand on a ray: the slot takes 14 of the 29 bits of a key, so hits that lie closer than
# 1e-4 of the ray's range can change places between two rounds, and each of them has alpha 0.01.
CROWD = 5e-3
# Any number of Gaussians up to this shares one compilation; nothing overflows, many hits a round.
LARGE = 10_000
LARGE_OPTIONS = TraceOptions(k=32, bundle=2, levels=1, group=4, transmittance_min=0.0)
LARGE_CAPACITY = Capacity((1250, 20_000), 160_000, 16_384)


@pytest.mark.ci
@pytest.mark.parametrize(
    "lens",
    [
        *(pytest.param(x, marks=pytest.mark.slow) for x in ("distorted", "polynomial")),
        "double_sphere",
        "sphere",
    ],
)
def test_values_and_gradients_are_those_of_the_brute_force(lens):
    motion = resting(padded(gaussians(5000, seed=5000, size=(0.02, 0.1)), LARGE))
    color, errors, report = against_brute_force(
        motion, seen_through(lens), LARGE_OPTIONS, LARGE_CAPACITY
    )
    assert int(report.hits) > 0
    assert color < COLOR
    assert max(errors.values()) < GRADIENT, errors


def test_ten_thousand_gaussians_on_one_ray_are_all_met():
    r = np.random.default_rng(0)
    crowd = gaussians(LARGE, seed=1, size=(0.5, 2.0))
    crowd = crowd._replace(
        mean=np.concatenate([0.1 * r.normal(size=(LARGE, 2)), r.uniform(1, 9, (LARGE, 1))], 1),
        opacity=r.uniform(0.006, 0.01, LARGE),
    )
    lines = rays(place=(0, 0, -8), jitter=0.02, spread=0.01)
    color, errors, report = against_brute_force(
        resting(crowd), lines, LARGE_OPTIONS, LARGE_CAPACITY
    )
    assert int(report.hits) > 0.99 * LARGE * RAYS
    assert color < COLOR
    assert max(errors.values()) < CROWD, errors
