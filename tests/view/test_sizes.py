"""Sizes of pictures: few, of one shape, and as large as time allows."""

import pytest

from gaussray.view.sizes import Pacer, ladder


def test_a_ladder_keeps_the_shape_and_ends_with_the_full_size():
    sizes = ladder((1920, 1080))
    assert sizes[-1] == (1920, 1080) and sizes[0][0] == 64
    assert all(a[0] < b[0] for a, b in zip(sizes, sizes[1:], strict=False))
    assert all(abs(h - w * 1080 / 1920) <= 0.5 for w, h in sizes)
    assert ladder((16, 8)) == [(16, 8)]


def test_what_is_unknown_is_small():
    assert Pacer(ladder((512, 512)), 100.0).size(4) == (64, 64)


def test_the_largest_size_within_the_budget():
    pacer = Pacer(ladder((512, 512)), budget=100.0)
    pacer.measured((64, 64), 1, 64 * 64 * 1e-3)  # a microsecond a ray
    # 100 ms are 100,000 rays; larger ones want a reserve of 1.3: 256^2 = 65,536 fit.
    assert pacer.size(1) == (256, 256)
    # Twice the rays of 192^2 = 73,728 fit without reserve, for nothing grows.
    assert pacer.size(2) == (192, 192)
    assert pacer.size(10_000) == (64, 64)


def test_a_cost_that_changes_is_followed():
    pacer = Pacer(ladder((512, 512)), budget=100.0)
    for _ in range(40):
        pacer.measured((64, 64), 1, 64 * 64 * 2e-3)
    assert pacer.cost == pytest.approx(2e-3)
    pacer.measured((64, 64), 2, 64 * 64 * 2 * 1e-3)
    assert 1e-3 < pacer.cost < 2e-3


def test_a_size_that_just_fits_does_not_flicker():
    pacer = Pacer(ladder((512, 512)), budget=100.0)
    cost = 100 / 256**2
    pacer.measured((256, 256), 1, 0.99 * cost * 256**2)
    # Too little reserve to grow to 256, and enough to stay there.
    assert pacer.size(1) == (192, 192)
    pacer.measured((192, 192), 1, 0.5 * cost * 192**2)
    assert pacer.size(1) == (256, 256) or pacer.cost > cost / 1.3
    for _ in range(20):
        pacer.measured((192, 192), 1, 0.7 * cost * 192**2)
    assert pacer.size(1) == (256, 256)
    for _ in range(40):
        pacer.measured((256, 256), 1, 0.95 * cost * 256**2)
        assert pacer.size(1) == (256, 256)
