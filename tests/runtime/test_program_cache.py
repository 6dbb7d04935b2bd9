"""Compiled programs are kept up to a number, the ones used last."""

import jax
import jax.numpy as jnp

from gaussray.runtime.program_cache import TRITON, ProgramCache, step_compiler


def test_sums_over_few_numbers_are_not_left_to_a_library():
    squared = jax.jit(lambda x: jnp.sum(x * x, axis=-1), compiler_options=step_compiler())
    program = squared.lower(jnp.ones((50_000, 3), jnp.float32)).compile()
    assert "ynn" not in (program.as_text() or "")
    assert jnp.all(squared(jnp.ones((50_000, 3), jnp.float32)) == 3)


def test_a_user_may_want_triton(monkeypatch):
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    for flags, expected in (("", {TRITON: False}), (f"--{TRITON}=true", {})):
        monkeypatch.setenv("XLA_FLAGS", flags)
        assert step_compiler.__wrapped__() == expected


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
