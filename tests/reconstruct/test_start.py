"""The state before the first step."""

import pytest

from gaussray.reconstruct.start import rows_beside_transients


@pytest.mark.parametrize(
    ("count", "most", "on_cpu", "on_gpu"),
    [
        # A CPU adds rows later; there is no row that the budget could not fill.
        (10_000, 40_000, 20_000, 40_000),
        (10_000, 15_000, 15_000, 15_000),
        # A GPU has rows for a large part of the budget, and never fewer than a CPU.
        (50_000, 1_000_000, 100_000, 300_000),
        (250_000, 1_000_000, 500_000, 500_000),
        (0, 0, 0, 0),
    ],
)
def test_gaussians_beside_transient_ones_begin_with_room(count, most, on_cpu, on_gpu):
    assert rows_beside_transients(count, most, gpu=False) == on_cpu
    assert rows_beside_transients(count, most, gpu=True) == on_gpu
