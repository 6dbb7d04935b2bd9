"""Rays that meet one Gaussian together, in machine code for a CPU.

All numbers of these rays are in one array, the block, in rows of `LANES` numbers at known places:
so the compiler knows that they do not overlap, and turns loops over the lanes into vector
instructions. Lanes without a ray, or whose ray does not hit the Gaussian, have a weight and
gradients of zero, and add nothing.
"""

import numpy as np

from gaussray.runtime.machine_code import allocating_code, machine_code, summing_code
from gaussray.tracer.cpu.hit import harmonics_of


_ZERO = np.float32(0)

# Rays of a block: those of the usual bundle.
LANES = 64
# Where the rows of a block begin. Of the rays: origin, direction and time, harmonics of the
# direction, and gradients of the loss with respect to the pixel's colour and depth.
AT_ORIGIN, AT_DIRECTION, AT_TIME, AT_HARMONICS, AT_PIXEL = (LANES * n for n in (0, 3, 6, 7, 23))
# Of their hits with one Gaussian: weight; distances t and q; colour, before it is tinted and what
# is below zero is cut. Gradients with respect to these take their places.
AT_WEIGHT, AT_T, AT_Q, AT_COLOR = (LANES * n for n in (27, 28, 29, 30))
AT_G_T, AT_G_Q, AT_G_COLOR = AT_T, AT_Q, AT_COLOR
# The Gaussian as each ray meets it, if that differs: matrix, mean; gradients to what was blended.
# The tint of its colour. When all Gaussians are met, cpu/kernel.py blends hits in these rows.
AT_MATRIX, AT_MEAN, AT_G_BLENDED = (LANES * n for n in (33, 42, 45))
AT_TINT = AT_MATRIX
# Sums of gradients over all Gaussians: origin, direction, time, harmonics.
AT_D_ORIGIN, AT_D_DIRECTION, AT_D_TIME, AT_D_HARMONICS = (LANES * n for n in (57, 60, 63, 64))
# Weights of key states, and then their gradients.
AT_KEYS = LANES * 80


@allocating_code
def new_block(keys):
    """A block for scenes of so many key states, all zero."""
    return np.zeros(AT_KEYS + 2 * keys * LANES, np.float32)


@machine_code
def begin_block(block, used, layout, rays, first, count):
    """Fill in the rays of a block, and set all its other numbers to zero.

    Args:
        block: the block.
        used: array that receives, for each key state, whether a ray has a weight of it.
        layout: columns of the rows.
        rays: origins, directions, weights of key states and times of all rays.
        first: index of the first ray.
        count: number of rays, at most `LANES`.
    """
    block[:] = _ZERO
    for c in range(3):
        for r in range(count):
            block[AT_ORIGIN + LANES * c + r] = rays.origin[c, first + r]
            block[AT_DIRECTION + LANES * c + r] = rays.direction[c, first + r]
    for r in range(count):
        i = first + r
        block[AT_TIME + r] = rays.time[0, i]
        d = (rays.direction[0, i], rays.direction[1, i], rays.direction[2, i])
        harmonics_of(d, layout.coefficients, block[AT_HARMONICS + r : AT_PIXEL : LANES])
    for k in range(layout.keys):
        used[k] = False
        for r in range(count):
            weight = rays.weights[k, first + r]
            block[AT_KEYS + LANES * k + r] = weight
            used[k] |= weight != _ZERO


@machine_code
def fill_pixel_gradients(block, g_pixel, first, count):
    """Fill in the gradients of the loss with respect to the pixels of the rays of a block.

    Args:
        block: the block.
        g_pixel: gradients of the loss with respect to colours and depths of all rays.
        first: index of the first ray.
        count: number of rays, at most `LANES`.
    """
    for c in range(4):
        for r in range(count):
            block[AT_PIXEL + LANES * c + r] = g_pixel[c, first + r]


@machine_code
def copy_row(block, source, target):
    """Copy a row whose place is found at run time to one whose place the compiler knows: loops over
    such rows alone become vector instructions.

    Args:
        block: the block.
        source: place of the row.
        target: where to copy it.
    """
    for r in range(LANES):
        block[target + r] = block[source + r]


@summing_code
def product_sum(block, one, other):
    """Sum over the lanes of the products of two rows.

    Args:
        block: the block.
        one: place of a row.
        other: place of the other.
    """
    total = _ZERO
    for r in range(LANES):
        total += block[one + r] * block[other + r]
    return total


@summing_code
def lane_sum(block, row):
    """Sum of a row over the lanes.

    Args:
        block: the block.
        row: place of the row.
    """
    total = _ZERO
    for r in range(LANES):
        total += block[row + r]
    return total
