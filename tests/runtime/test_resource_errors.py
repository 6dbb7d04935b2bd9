"""Who runs out of disk or memory is told what was asked for, and what to change."""

import errno
import os
import resource

import jax
import numpy as np
import pytest

from gaussray.cli import run
from gaussray.cli.main import main
from gaussray.runtime.resource_errors import is_full, is_memory, memory_message


EXHAUSTED = jax.errors.JaxRuntimeError(
    "RESOURCE_EXHAUSTED: Out of memory allocating 64000000000 bytes."
)


def caused(error):
    """An error whose cause is this one."""
    try:
        raise ValueError("a.npz: cannot be written") from error
    except ValueError as found:
        return found


def test_a_full_disk_is_known_by_its_cause():
    assert is_full(caused(OSError(errno.ENOSPC, "No space left on device")))
    assert not is_full(caused(OSError(errno.EACCES, "Permission denied")))


def test_memory_is_known_whoever_lacks_it():
    assert is_memory(EXHAUSTED) and is_memory(MemoryError()) and is_memory(caused(MemoryError()))
    assert not is_memory(jax.errors.JaxRuntimeError("INTERNAL: no"))


@pytest.mark.parametrize(
    ("verb", "key"), [("render", "render.memory"), ("reconstruct", "fit.tiles")]
)
def test_the_size_is_told_and_the_key_to_lower(verb, key):
    line = memory_message(verb, EXHAUSTED)
    assert "out of memory: 64 GB were requested at once" in line
    assert f"Lower {key}" in line


def test_what_the_host_lends_is_told_and_what_would_fit(monkeypatch):
    unlimited, limited = resource.RLIM_INFINITY, (12 * 10**9, resource.RLIM_INFINITY)
    monkeypatch.setattr(os, "sysconf", {"SC_PHYS_PAGES": 4_000_000, "SC_PAGE_SIZE": 4000}.get)
    monkeypatch.setattr(resource, "getrlimit", lambda _: (unlimited, unlimited))
    assert "of a host with 16 GB. Lower render.memory to 4." in memory_message("render", EXHAUSTED)
    monkeypatch.setattr(resource, "getrlimit", lambda _: limited)
    assert "of a host with 12 GB. Lower render.memory to 3." in memory_message("render", EXHAUSTED)


def test_the_size_that_a_host_could_not_give_is_read_too():
    with pytest.raises(MemoryError) as found:
        np.empty((1 << 50,), np.uint8)
    assert "1.13e+06 GB were requested" in memory_message("render", found.value)


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (EXHAUSTED, "Lower render.memory"),
        (
            caused(OSError(errno.ENOSPC, "no")),
            "written. The disk is full: make room. The",
        ),
    ],
)
def test_the_command_ends_in_one_line(error, told, monkeypatch, capsys):
    def fail(words):
        raise error

    monkeypatch.setattr(run, "_dispatch", fail)
    with pytest.raises(SystemExit) as stop:
        main(["render", "out=x"])
    (line,) = capsys.readouterr().err.splitlines()
    assert stop.value.code == 2 and told in line
