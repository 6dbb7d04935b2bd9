"""Lengths of the tracer's lists: how they grow, and that those of stages are powers of two."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gaussray.render.list_sizes import enlarge_program_capacity, round_capacity
from gaussray.tracer.trace import Report
from gaussray.tracer.traverse import Capacity


def sizes(capacity):
    return [*capacity.cells, capacity.pairs, capacity.slots, capacity.transient]


def test_sizes_are_rounded_up_to_the_next_power_of_two_and_nothing_stays_nothing():
    assert sizes(round_capacity(Capacity((1, 2, 3), 1024, 1025, 0))) == [1, 2, 4, 1024, 2048, 0]
    rng = np.random.default_rng(0)
    for numbers in rng.integers(1, 1 << 20, (50, 4)):
        rounded = sizes(round_capacity(Capacity((int(numbers[0]),), *map(int, numbers[1:]))))
        expected = [2 ** int(np.ceil(np.log2(n))) for n in numbers]
        assert rounded == expected


@pytest.mark.parametrize("staged", [True, False])
def test_all_sizes_have_room_for_what_is_needed_and_only_those_of_stages_are_rounded(staged):
    held, needed = Capacity((64,), 64, 16, 8), [100, 10, 16, 50]
    cells, pairs, slots, transient = sizes(
        enlarge_program_capacity(held, needed, staged=staged, headroom=2.0)
    )
    assert pairs == 64 and slots == 16
    # Without stages: twice what is needed, rounded up to an eighth of a power of two.
    assert (cells, transient) == ((256, 128) if staged else (224, 112))


def test_lists_are_as_long_as_the_device_with_the_longest_needs():
    none, hits = jnp.zeros((), int), jnp.zeros(())
    each = [Report(jnp.array(n), none, none, hits) for n in ([10, 70, 16], [90, 20, 17])]
    report = jax.tree.map(lambda *x: np.stack(x), *each)
    held = Capacity((64,), 64, 16)
    longer = enlarge_program_capacity(held, report.largest_needed(), staged=True)
    assert sizes(longer) == [256, 128, 32, 0]
