"""Commands end without a word of OpenImageIO's binding."""

import subprocess
import sys


# A class that JAX knows, in a module that knows one that reads pictures.
SCRIPT = "import gaussray.capture.selection, gaussray.capture.frames, gaussray.dataset.layers"


def test_nothing_of_the_library_outlives_the_interpreter():
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
