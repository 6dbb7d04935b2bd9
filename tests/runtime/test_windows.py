"""Windows lacks modules and flags of POSIX: all modules import without them, and verbs run."""

import os
import subprocess
import sys

import pytest


WITHOUT = """
import importlib, os, pkgutil, signal, sys
import av, filelock, hydra, jax, numba, numpy, OpenImageIO, scipy  # these know Windows themselves
for name in ("torch", "viser", "pycolmap"):
    try:
        importlib.import_module(name)  # so do these, where they are installed
    except ModuleNotFoundError:
        pass
for name in (
    "O_NONBLOCK", "O_CLOEXEC", "uname", "sched_getaffinity", "sysconf", "sysconf_names", "getuid",
    "fork", "mkfifo",
):
    delattr(os, name)
for name in ("SIGKILL", "SIGHUP", "SIGUSR1", "SIGALRM"):
    delattr(signal, name)
for name in ("fcntl", "resource", "pwd", "grp", "termios"):
    sys.modules[name] = None

def refused(*_, **__):
    raise OSError("A required privilege is not held by the client")

os.symlink = refused
"""
IMPORTS = """
import gaussray
for module in pkgutil.walk_packages(gaussray.__path__, "gaussray."):
    try:
        importlib.import_module(module.name)
    except ModuleNotFoundError as error:
        if error.name not in ("viser", "torch", "pycolmap"):
            raise
from gaussray.io.safe.files import read_text
from gaussray.runtime.resource_errors import memory_message
assert read_text(sys.argv[1]) == b"a\\r\\n"
assert "out of memory" in memory_message("render", MemoryError())
"""
VERB = """
from gaussray.cli.main import main
main(sys.argv[1:])
"""


def run_without_posix(program, *words):
    """What a process without POSIX prints."""
    command = [sys.executable, "-c", WITHOUT + program, *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, env={**os.environ})
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.ci
def test_no_module_needs_anything_of_posix(tmp_path):
    path = tmp_path / "a.txt"
    path.write_bytes(b"a\r\n")
    run_without_posix(IMPORTS, path)


@pytest.mark.slow
def test_a_dataset_is_rendered_and_packed_without_posix(tmp_path):
    words = ["render", "scene=sample", "camera=look_at", "dataset.count=1", "film.size=[32,32]"]
    told = run_without_posix(VERB, *words, "render.samples=1", f"out={tmp_path}/data")
    assert "1 samples" in told
    pack = ["pack", f"data={tmp_path}/data", f"out={tmp_path}/tars"]
    run_without_posix(VERB, *pack)
    assert (tmp_path / "tars/000000.tar").is_file()
    run_without_posix(VERB, "export", "scene=sample", f"out={tmp_path}/a.ply", "time=0.5")
    assert (tmp_path / "a.ply").is_file()
