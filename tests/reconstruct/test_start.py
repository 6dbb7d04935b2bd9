"""The state before the first step."""

import pytest

from gaussray.reconstruct.start import rows_beside_transients


@pytest.mark.parametrize(
    ("count", "budget", "share", "rows"),
    [
        # Few Gaussians that move may become many; many that rest are not expected to.
        (5_000, 200_000, 0.0, 10_000),
        (5_000, 200_000, 0.25, 50_000),
        (65_000, 200_000, 0.25, 130_000),
        (5_000, 200_000, 1.0, 200_000),
        # There is no row that the budget could not fill, and none for what there is none of.
        (10_000, 15_000, 0.0, 15_000),
        (0, 200_000, 1.0, 0),
    ],
)
def test_gaussians_beside_transient_ones_begin_with_room(count, budget, share, rows):
    assert rows_beside_transients(count, budget, share=share) == rows
