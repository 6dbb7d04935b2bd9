"""Sorting of the hits of all rays of a block together, in machine code for a CPU."""

from gaussray.runtime.machine_code import machine_code
from gaussray.tracer.cpu.block import LANES


@machine_code
def sort_lanes(numbers, count):
    """Sort the first numbers of every lane, the smallest first.

    Which numbers are compared does not depend on them (Batcher's merge exchange), so all lanes
    do it at once, in vectors, and no branch is mispredicted.

    Args:
        numbers: rows of `LANES` numbers.
        count: how many rows to sort.
    """
    size = 1
    while size < count:
        apart = size
        while apart > 0:
            for begin in range(apart % size, count - apart, 2 * apart):
                for i in range(begin, min(begin + apart, count - apart)):
                    # Both belong to the same pair of sorted parts.
                    if i ^ (i + apart) < 2 * size:
                        _exchange(numbers, i, i + apart)
            apart //= 2
        size *= 2


@machine_code
def _exchange(numbers, i, j):
    """Put the smaller number of each lane into row i, the larger one into row j."""
    for r in range(LANES):
        one, other = numbers[i, r], numbers[j, r]
        numbers[i, r], numbers[j, r] = min(one, other), max(one, other)
