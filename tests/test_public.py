"""What `import gaussray` gives, and what it does not load."""

import subprocess
import sys

import gaussray


HEAVY = ("hydra", "omegaconf", "OpenImageIO", "skimage", "av", "jaxopt")
MOST_NAMES = 25


def test_import_is_light():
    code = f"import gaussray, sys; print([m for m in {HEAVY} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_public_names_are_few():
    public = [name for name in vars(gaussray) if not name.startswith("_")]
    modules = [name for name in public if f"gaussray.{name}" in sys.modules]
    assert len(public) - len(modules) <= MOST_NAMES
