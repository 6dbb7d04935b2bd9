"""What is compiled is kept where it may be, and nowhere else."""

import os
from types import SimpleNamespace

import jax
import pytest

from gaussray.runtime.jit_cache import MIN_COMPILE_SECONDS, keep_programs


@pytest.fixture
def nowhere(monkeypatch):
    """No folder of programs is known; afterwards it is again that of the tests."""
    before = (
        jax.config.jax_compilation_cache_dir,
        jax.config.jax_persistent_cache_min_compile_time_secs,
    )
    jax.config.update("jax_compilation_cache_dir", None)
    yield
    jax.config.update("jax_compilation_cache_dir", before[0])
    jax.config.update("jax_persistent_cache_min_compile_time_secs", before[1])


def test_programs_are_kept_in_the_users_cache_by_processor(nowhere, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    path = keep_programs("auto")
    assert path.parent == tmp_path / "gaussray"
    assert path.is_dir() and jax.config.jax_compilation_cache_dir == str(path)
    for name in ("one", "other", "one"):
        machine = SimpleNamespace(machine=name)
        monkeypatch.setattr(os, "uname", lambda machine=machine: machine, raising=False)
        jax.config.update("jax_compilation_cache_dir", None)
        assert keep_programs("auto").parent == path.parent
    assert len(list(path.parent.iterdir())) == 3


def test_the_environment_comes_first(tmp_path):
    assert str(keep_programs(str(tmp_path / "other"))) == jax.config.jax_compilation_cache_dir
    assert not (tmp_path / "other").exists()


def test_nothing_is_kept_if_nowhere_is_asked_for_or_possible(nowhere, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert keep_programs("auto") is None and keep_programs("") is None
    assert not jax.config.jax_compilation_cache_dir


def test_a_folder_that_cannot_be_is_named_by_its_key(nowhere, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match=r"devices.programs=.*cannot be written"):
        keep_programs(str(tmp_path / "file" / "in"))


@pytest.mark.parametrize(("wanted", "kept"), [(None, MIN_COMPILE_SECONDS), ("3", 1.0)])
def test_short_programs_are_kept_in_a_known_folder_unless_the_user_says_otherwise(
    nowhere, tmp_path, monkeypatch, wanted, kept
):
    name = "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"
    monkeypatch.delenv(name, raising=False)
    if wanted:
        monkeypatch.setenv(name, wanted)
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 1.0)
    assert keep_programs("auto") == tmp_path
    # JAX itself has read the variable, when it was imported.
    assert jax.config.jax_persistent_cache_min_compile_time_secs == kept
