"""The state before the first step."""

import pytest

from gaussray.reconstruct.start import rows_beside_transients


@pytest.mark.parametrize(
    ("count", "budget", "on_cpu", "on_gpu"),
    [
        # Few Gaussians that move may become many; many that rest are not expected to.
        (5_000, 200_000, 10_000, 50_000),
        (65_000, 200_000, 130_000, 130_000),
        # There is no row that the budget could not fill, and none for what there is none of.
        (10_000, 15_000, 15_000, 15_000),
        (0, 200_000, 0, 0),
    ],
)
def test_gaussians_beside_transient_ones_begin_with_room(count, budget, on_cpu, on_gpu):
    assert rows_beside_transients(count, budget, gpu=False) == on_cpu
    assert rows_beside_transients(count, budget, gpu=True) == on_gpu
