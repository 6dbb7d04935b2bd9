"""Cells hold every Gaussian once, and their boxes hold what the cells hold."""

import functools

import jax
import numpy as np
import pytest
import reference
from scenes import gaussians, moving, resting, wandering

from gaussray.tracer.grid import OCCUPANCY, build_grid


ALPHA_MIN = 1 / 255
make = jax.jit(functools.partial(build_grid, alpha_min=ALPHA_MIN))


def test_every_visible_gaussian_is_in_one_cell():
    matter = gaussians(61)
    matter.opacity[5] = 0
    matter.mean[7] = np.nan
    grid = make(resting(matter))
    index = np.asarray(grid.index)
    assert index.shape == (-(-61 // OCCUPANCY), OCCUPANCY)
    np.testing.assert_array_equal(np.sort(index[index >= 0]), np.setdiff1d(np.arange(61), [5, 7]))
    assert int(grid.dropped) == 1


def test_boxes_hold_the_ellipsoids_at_all_times():
    time, matter = moving(61, keys=5, size=(0.01, 1.0), amount=0.3)
    motion = wandering(time, matter)
    grid = make(motion)
    axes = reference.rotation(matter.quat) * matter.scale[..., None, :]
    radius = np.sqrt(2 * np.log(matter.opacity / ALPHA_MIN))
    shares = reference.key_shares(time, np.linspace(-0.1, 1.1, 121))
    axes, mean = np.tensordot(shares, axes, 1), np.tensordot(shares, matter.mean, 1)
    half = np.linalg.norm(axes, axis=-1) * radius[:, None]
    # The slack of the boxes in single precision covers the rounding of the inputs.
    lower, upper = np.min(mean - half, axis=0), np.max(mean + half, axis=0)
    low, high = np.asarray(grid.lower), np.asarray(grid.upper)
    for cell, members in enumerate(np.asarray(grid.index)):
        members = members[members >= 0]
        assert np.all(low[cell] <= lower[members]) and np.all(high[cell] >= upper[members])


def test_a_huge_gaussian_does_not_share_a_cell_with_tiny_ones():
    matter = gaussians(64, size=(1e-3, 2e-3))
    matter.scale[10] = 1e3
    matter.opacity[10] = 0.5
    grid = make(resting(matter))
    wide = np.max(np.asarray(grid.upper) - np.asarray(grid.lower), axis=1) > 1e3
    assert np.sum(wide) == 1
    (members,) = np.asarray(grid.index)[wide]
    # It is the largest: at the end of the order, with at most one cell of company.
    assert members[-1] == 10


@pytest.mark.parametrize("count", [0, 1])
def test_hardly_any_gaussians_make_one_cell(count):
    grid = make(resting(jax.tree.map(lambda x: x[:count], gaussians(1))))
    np.testing.assert_array_equal(np.asarray(grid.index)[0, :1], [0] if count else [-1])
    assert grid.index.shape == (1, OCCUPANCY) and int(grid.dropped) == 0


def test_neighbours_in_space_are_neighbours_in_the_grid():
    matter = gaussians(4096, size=(1e-3, 2e-3))
    grid = make(resting(matter))
    box = np.asarray(grid.upper) - np.asarray(grid.lower)
    # Eight random ones would span 1.6 of the cube's 2; a cell of eight has an edge of about 0.25.
    assert np.median(np.max(box, axis=1)) < 0.6
