"""Compiled programs are kept up to a number; those that are forgotten give back their memory."""

import pathlib

import jax
import jax.numpy as jnp
import pytest

from gaussray.runtime.programs import ProgramCache


def mappings():
    return len(pathlib.Path("/proc/self/maps").read_text().splitlines())


def test_a_program_is_made_once_and_the_one_used_longest_ago_is_forgotten():
    made = []

    @ProgramCache(2)
    def program(key):
        made.append(key)
        return jax.jit(lambda x: x + key)

    first = program(1)
    program(2)
    assert program(1) is first and made == [1, 2]
    program(3)
    assert program(1) is first and made == [1, 2, 3]
    program(2)
    assert made == [1, 2, 3, 2]


@pytest.mark.skipif(not pathlib.Path("/proc/self/maps").exists(), reason="maps are Linux's")
def test_memory_mappings_do_not_grow_with_the_number_of_programs():
    @ProgramCache(2)
    def program(key):
        return jax.jit(lambda x: jnp.sort(jnp.sin(x) * key)[::-1] @ jnp.cos(x))

    counts = []
    for key in range(12):
        program(key)(jnp.ones(64 + key)).block_until_ready()
        counts.append(mappings())
    assert counts[-1] - counts[3] < 0.25 * 8 * (counts[2] - counts[0]) / 2, counts
