"""Compiled programs are kept up to a number, the ones used last."""

import jax

from gaussray.runtime.programs import ProgramCache


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
