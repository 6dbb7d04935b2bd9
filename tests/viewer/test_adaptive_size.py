"""Sizes of pictures: few, of one shape, and as large as time allows."""

import pytest

from gaussray.viewer.adaptive_size import SizeController, preview_sizes


def test_a_ladder_keeps_the_shape_and_ends_with_the_full_size():
    sizes = preview_sizes((1920, 1080))
    assert sizes[-1] == (1920, 1080) and sizes[0][0] == 64
    assert all(a[0] < b[0] for a, b in zip(sizes, sizes[1:], strict=False))
    assert all(abs(h - w * 1080 / 1920) <= 0.5 for w, h in sizes)
    assert preview_sizes((16, 8)) == [(16, 8)]


def test_what_is_unknown_is_small():
    assert SizeController(preview_sizes((512, 512)), 100.0).size(4) == (64, 64)


def taught(fixed, slope, *, budget=100.0, sizes=((64, 64), (96, 96))):
    """A controller that has measured two sizes with these costs per picture and per ray."""
    size_controller = SizeController(preview_sizes((512, 512)), budget)
    for w, h in sizes:
        size_controller.record((w, h), 1, fixed + slope * w * h)
    return size_controller


def test_the_largest_size_within_the_budget():
    size_controller = taught(0.0, 1e-3)
    # 100 ms are 100,000 rays; larger ones want a reserve of 1.3: 256^2 = 65,536 fit.
    assert size_controller.size(1) == (256, 256)
    # Twice the rays of 192^2 = 73,728 fit without reserve, for nothing grows.
    assert size_controller.size(2) == (192, 192)
    assert size_controller.size(10_000) == (64, 64)


def test_what_every_picture_costs_is_told_from_what_a_ray_costs():
    size_controller = taught(40.0, 5e-4)
    assert size_controller.milliseconds(256 * 256) == pytest.approx(40 + 5e-4 * 256 * 256)
    # By the time of the smallest alone, 42 ms for 4,096 rays, 96 x 96 would take 95 ms.
    assert size_controller.size(1) == (256, 256)


def test_a_machine_that_is_too_slow_gets_the_smallest():
    assert taught(200.0, 5e-4).size(1) == (64, 64)


def test_after_one_picture_larger_ones_are_expected_to_cost_less_than_their_rays():
    size_controller = SizeController(preview_sizes((512, 512)), budget=100.0)
    size_controller.record((64, 64), 1, 40.0)
    assert 40.0 < size_controller.milliseconds(2 * 64 * 64) < 80.0
    assert size_controller.size(1) == (96, 96)


def test_a_cost_that_changes_is_followed_at_all_sizes():
    size_controller = taught(0.0, 2e-3)
    for _ in range(40):
        size_controller.record((64, 64), 1, 64 * 64 * 1e-3)
    assert size_controller.milliseconds(64 * 64) == pytest.approx(64 * 64 * 1e-3, rel=1e-3)
    assert size_controller.milliseconds(96 * 96) == pytest.approx(96 * 96 * 1e-3, rel=1e-3)


def test_a_size_that_just_fits_does_not_flicker():
    size_controller = taught(0.0, 0.9 * 100 / 256**2, sizes=((192, 192), (128, 128)))
    # Too little reserve to grow to 256 ...
    assert size_controller.size(1) == (192, 192)
    for _ in range(20):
        size_controller.record((192, 192), 1, 0.7 * 100 * (192 / 256) ** 2)
    assert size_controller.size(1) == (256, 256)
    # ... and enough to stay there.
    for _ in range(40):
        size_controller.record((256, 256), 1, 95.0)
        assert size_controller.size(1) == (256, 256)


def test_times_that_fall_with_size_are_noise():
    size_controller = SizeController(preview_sizes((512, 512)), budget=100.0)
    size_controller.record((64, 64), 1, 30.0)
    size_controller.record((96, 96), 1, 25.0)
    assert size_controller.milliseconds(512 * 512) >= 25.0
