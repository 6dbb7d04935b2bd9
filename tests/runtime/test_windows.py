"""Windows lacks modules and flags of POSIX: `io` and `runtime` import without them."""

import os
import subprocess
import sys


WITHOUT = """
import importlib, os, pkgutil, sys, pathlib
import filelock, jax, OpenImageIO, scipy, numpy  # these know Windows by themselves
for name in ("O_NONBLOCK", "O_CLOEXEC", "uname", "sched_getaffinity", "sysconf", "sysconf_names"):
    delattr(os, name)
for name in ("fcntl", "resource", "pwd", "grp", "termios"):
    sys.modules[name] = None
import gaussray.io, gaussray.runtime
for package in (gaussray.io, gaussray.runtime):
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        importlib.import_module(module.name)
from gaussray.io.safe.files import read_text
from gaussray.runtime.resource_errors import memory_message
assert read_text(sys.argv[1]) == b"a\\r\\n"
assert "out of memory" in memory_message("render", MemoryError())
"""


def test_io_and_runtime_need_nothing_of_posix(tmp_path):
    path = tmp_path / "a.txt"
    path.write_bytes(b"a\r\n")
    words = [sys.executable, "-c", WITHOUT, str(path)]
    done = subprocess.run(words, capture_output=True, text=True, env={**os.environ})
    assert done.returncode == 0, done.stderr
