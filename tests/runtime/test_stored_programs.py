"""Programs on disk give the same results in a process that has never traced them."""

import os
import pickle
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array

from gaussray.runtime import program_files, recent_programs
from gaussray.runtime.program_files import kept_text
from gaussray.runtime.recent_programs import read_ahead
from gaussray.runtime.stored_programs import KeptProgram, kept_jit


class Sum(eqx.Module):
    """A result with a static field and a missing one."""

    value: Array
    rest: Array | None
    power: int = eqx.field(static=True)


class Factor(eqx.Module):
    """An option, which is no array."""

    factor: float = eqx.field(static=True)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(program_files, "_folders", [(tmp_path, "a processor")])
    return tmp_path


def powers(power, traced):
    def run(x, pair):
        traced.append(power)
        return Sum(x**power + pair["y"], None, power), (pair["y"] * 2,)

    return KeptProgram(run, ("powers", power))


def test_a_kept_program_is_not_traced_again(folder):
    x, pair, traced = jnp.arange(3.0), {"y": np.float32(2)}, []
    first, later = powers(2, traced), powers(2, traced)
    seen = first(x, pair), first(x, pair), later(x, pair)
    assert traced == [2] and len(list(folder.iterdir())) == 1
    for total, (double,) in seen:
        np.testing.assert_array_equal(total.value, [2, 3, 6])
        assert total.rest is None and total.power == 2 and float(double) == 4


def test_of_several_threads_one_compiles(folder):
    x, pair, traced = jnp.arange(3.0), {"y": np.float32(2)}, []
    program, begin = powers(2, traced), threading.Barrier(4, timeout=20.0)

    def call(_):
        begin.wait()
        return float(program(x, pair)[0].value[2])

    with ThreadPoolExecutor(4) as threads:
        assert list(threads.map(call, range(4))) == [6.0] * 4
    assert traced == [2]


def test_a_kept_function_is_traced_once_for_everything_that_is_no_array(folder):
    traced = []

    def twice():
        def scaled(total, factor, offset=None):
            traced.append(factor)
            return Sum(total.value * factor.factor, total.rest, total.power), offset

        return kept_jit(scaled)

    total = Sum(jnp.arange(3.0), None, 2)
    for function in (twice(), twice()):
        for factor in (2.0, 2.0, 3.0):
            got, offset = function(total, Factor(factor), offset=jnp.ones(()))
            np.testing.assert_array_equal(got.value, factor * np.arange(3.0))
            assert got.rest is None and got.power == 2 and float(offset) == 1
    assert traced == [Factor(2.0), Factor(3.0)] and len(list(folder.iterdir())) == 2


def test_in_a_trace_a_kept_function_is_an_ordinary_one(folder):
    square = kept_jit(lambda x: x * x)
    assert jax.grad(square)(3.0) == 6
    np.testing.assert_array_equal(jax.vmap(square)(jnp.arange(3.0)), [0, 1, 4])
    np.testing.assert_array_equal(jax.jit(square)(jnp.arange(3.0)), [0, 1, 4])
    assert not list(folder.iterdir())


def test_expected_programs_are_traced_once_and_take_each_others_results(folder):
    x, pair, traced = jnp.arange(3.0), {"y": np.float32(2)}, []

    def both(known):
        first, second = powers(2, known), KeptProgram(lambda total: total.value + 1, ("more",))
        total, _ = first.expect(x, pair)
        assert total.value.shape == (3,) and total.rest is None and total.power == 2
        assert second.expect(total).dtype == x.dtype
        later = second(first(x, pair)[0])
        np.testing.assert_array_equal(later, [3, 4, 7])

    both(traced)
    assert traced == [2] and len(list(folder.iterdir())) == 2
    both(traced)
    assert traced == [2] and len(list(folder.iterdir())) == 2


def test_an_expected_program_whose_file_is_damaged_is_compiled(folder):
    x, pair, traced = jnp.arange(3.0), {"y": np.float32(2)}, []
    powers(2, traced)(x, pair)
    (path,) = folder.iterdir()
    _, *others = pickle.loads(path.read_bytes())
    path.write_bytes(pickle.dumps((b"no program", *others)))
    path.chmod(0o600)
    program = powers(2, traced)
    program.expect(x, pair)
    np.testing.assert_array_equal(program(x, pair)[0].value, [2, 3, 6])
    assert traced == [2, 2]


def test_what_is_not_kept_is_not_expected(monkeypatch, folder):
    assert KeptProgram(jnp.sin, (object(),)).expect(jnp.ones(2)) is None
    monkeypatch.setattr(program_files, "_folders", [])
    assert KeptProgram(jnp.sin, ("sine",)).expect(jnp.ones(2)) is None


def test_what_a_program_needs_is_there_before_it_is_read(folder):
    calls = []
    for expected in (False, False, True):
        program = KeptProgram(jnp.sin, ("sine",), needs=lambda: calls.append(1))
        if expected:
            program.expect(jnp.ones(2))
        program(jnp.ones(2))
    assert calls == [1, 1]


def test_what_the_last_process_of_a_kind_asked_for_is_read_ahead(folder, monkeypatch):
    monkeypatch.setattr(recent_programs, "_lists", {})
    monkeypatch.setattr(recent_programs, "_ahead", {})
    x, pair, traced = jnp.arange(3.0), {"y": np.float32(2)}, []
    read_ahead("a fit")
    powers(2, traced)(x, pair)
    KeptProgram(jnp.sin, ("sine",), needs=lambda: None)(x)
    assert not recent_programs._ahead
    read_ahead("another fit")
    assert not recent_programs._ahead
    read_ahead("a fit")
    ((path, future),) = recent_programs._ahead.items()
    future.result()
    # What is on disk is not looked at again.
    path.write_bytes(b"no program")
    path.chmod(0o600)
    np.testing.assert_array_equal(powers(2, traced)(x, pair)[0].value, [2, 3, 6])
    assert traced == [2] and not recent_programs._ahead


def test_a_list_of_missing_and_damaged_programs_does_no_harm(folder, monkeypatch):
    monkeypatch.setattr(recent_programs, "_lists", {})
    monkeypatch.setattr(recent_programs, "_ahead", {})
    x, pair, traced = jnp.arange(3.0), {"y": np.float32(2)}, []
    read_ahead("a fit")
    for power in (2, 3):
        powers(power, traced)(x, pair)
    two, three = (folder / name for name in next(iter(recent_programs._lists.values())))
    two.unlink()
    three.write_bytes(b"no program")
    three.chmod(0o600)
    read_ahead("a fit")
    for power in (2, 3):
        powers(power, traced)(x, pair)
    assert traced == [2, 3, 2, 3]


def test_a_program_that_others_may_write_to_is_not_loaded(folder):
    x, pair, traced = jnp.arange(3.0), {"y": np.float32(2)}, []
    powers(2, traced)(x, pair)
    (file,) = folder.iterdir()
    assert file.stat().st_mode & 0o777 == 0o600
    file.chmod(0o666)
    powers(2, traced)(x, pair)
    assert traced == [2, 2]


def test_keys_shapes_types_and_processors_have_programs_of_their_own(folder, monkeypatch):
    traced, pair = [], {"y": np.float32(2)}
    powers(2, traced)(jnp.arange(3.0), pair)
    powers(3, traced)(jnp.arange(3.0), pair)
    powers(2, traced)(jnp.arange(4.0), pair)
    powers(2, traced)(jnp.arange(3), pair)
    powers(2, traced)(np.arange(3, dtype=np.float32), pair)
    monkeypatch.setattr(program_files, "_folders", [(folder, "another")])
    powers(2, traced)(jnp.arange(3.0), pair)
    assert traced == [2, 3, 2, 2, 2, 2] and len(list(folder.iterdir())) == 6


def test_a_damaged_file_is_written_anew(folder):
    traced, pair = [], {"y": np.float32(2)}
    powers(2, traced)(jnp.arange(3.0), pair)
    (path,) = folder.iterdir()
    whole = path.stat().st_size
    path.write_bytes(b"no program")
    total, _ = powers(2, traced)(jnp.arange(3.0), pair)
    np.testing.assert_array_equal(total.value, [2, 3, 6])
    assert traced == [2, 2] and abs(path.stat().st_size - whole) < 0.1 * whole


@pytest.mark.ci
def test_a_program_that_jax_keeps_too_is_written_whole(folder):
    # JAX's own cache in the same folder, for programs of any length of compilation.
    env = os.environ | {
        "JAX_NUM_CPU_DEVICES": "2",
        "JAX_PLATFORMS": "cpu",
        "JAX_COMPILATION_CACHE_DIR": str(folder),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    }
    for attempt in range(3):
        if attempt == 1:
            for path in folder.glob("*.program"):
                path.unlink()
        words = [sys.executable, "-c", TWO_DEVICES, str(folder)]
        done = subprocess.run(words, env=env, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        assert len(list(folder.glob("*.program"))) == 2


def test_the_oldest_files_are_removed(folder, monkeypatch):
    monkeypatch.setattr(program_files, "MOST_FILES", 2)
    for power in (1, 2, 3):
        powers(power, [])(jnp.arange(3.0), {"y": np.float32(2)})
    assert len(list(folder.iterdir())) == 2


def test_a_key_that_does_not_say_what_it_is_keeps_nothing(folder):
    program = KeptProgram(jnp.sin, (object(),))
    np.testing.assert_allclose(program(jnp.ones(2)), np.sin([1.0, 1.0]), rtol=1e-6)
    assert not list(folder.iterdir())


def test_a_text_is_made_once_for_a_key(folder):
    made = []

    def text():
        made.append(1)
        return "no such axis"

    assert [kept_text(("a", 1), text) for _ in range(3)] == ["no such axis"] * 3
    assert made == [1] and len(list(folder.iterdir())) == 1
    kept_text(("a", 2), text)
    assert made == [1, 1]
    for file in folder.iterdir():
        file.chmod(0o666)
    kept_text(("a", 2), text)
    assert made == [1, 1, 1]


def test_options_that_differ_in_the_last_digit_have_keys_of_their_own(folder):
    options = [Factor(0.1), Factor(0.1 + 1e-18), Factor(np.nextafter(0.1, 1).item())]
    assert [kept_text((x,), lambda x=x: str(x.factor)) for x in options] == [
        "0.1",
        "0.1",
        "0.10000000000000002",
    ]


def test_without_a_folder_a_program_is_an_ordinary_one(monkeypatch, folder):
    monkeypatch.setattr(program_files, "_folders", [])
    traced = []
    program = powers(2, traced)
    gradient = jax.grad(lambda x: program(x, {"y": x})[0].value)(3.0)
    assert gradient == 7 and not list(folder.iterdir())


TWO_DEVICES = """
import sys
from pathlib import Path
import jax, jax.numpy as jnp, numpy as np
from jax.sharding import PartitionSpec
from gaussray.runtime.program_files import keep_machine_code
from gaussray.runtime.recent_programs import read_ahead
from gaussray.runtime.stored_programs import KeptProgram
from gaussray.tracer.shard import mesh

keep_machine_code(Path(sys.argv[1]), "a processor")
assert len(jax.devices()) == 2
mesh = mesh()
split = PartitionSpec("rays")
each = jax.shard_map(lambda x: x + x.shape[0], mesh=mesh, in_specs=split, out_specs=split)
alone = KeptProgram(lambda x: x + 1, ("alone",))
print(alone(jnp.zeros(4)), KeptProgram(each, ("each",))(np.zeros(4)))
"""


@pytest.mark.ci
def test_programs_of_one_and_of_two_devices_share_a_process(folder):
    env = os.environ | {"JAX_NUM_CPU_DEVICES": "2", "JAX_PLATFORMS": "cpu"}
    words = [sys.executable, "-c", TWO_DEVICES, str(folder)]
    for _ in range(2):
        done = subprocess.run(words, env=env, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        assert done.stdout.split() == "[1. 1. 1. 1.] [2. 2. 2. 2.]".split()
        assert len(list(folder.iterdir())) == 2
