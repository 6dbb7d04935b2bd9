"""Rays dealt out to two devices see what one device sees."""

import os
import subprocess
import sys
from pathlib import Path

import pytest


# A process has its devices for life, so two of them need a process of their own.
HERE = Path(__file__).parent


@pytest.mark.ci
def test_two_devices_see_and_learn_what_one_does():
    env = os.environ | {"JAX_NUM_CPU_DEVICES": "2", "JAX_PLATFORMS": "cpu"}
    path = [str(HERE), str(HERE.parent), env.get("PYTHONPATH", "")]
    env["PYTHONPATH"] = os.pathsep.join(filter(None, path))
    words = [sys.executable, str(HERE / "two_devices.py")]
    done = subprocess.run(words, env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["the", "same"]
