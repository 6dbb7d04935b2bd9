"""A process ends in silence."""

import subprocess
import sys


def test_a_process_that_reads_pictures_ends_without_a_word():
    # Classes of equinox beside what reads pictures: JAX's registry holds both to the end.
    words = [sys.executable, "-W", "ignore", "-c", "import gaussray.evaluate, gaussray.optics"]
    ended = subprocess.run(words, capture_output=True, text=True)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "", "")
