"""The README's headline figures, measured again: `pytest -m slow tests/test_sample_quality.py`."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest


README = Path(__file__).parents[1] / "README.md"
# In dB: what other devices and versions of XLA change of a reconstruction of 1,300 steps.
TOLERANCE = 0.5
EFFECTS = {
    "pinhole": r"([\d.]+) dB at held-out pinhole",
    "depth_of_field": r"([\d.]+) dB with depth of\s+field",
    "fisheye": r"([\d.]+) dB through a\s+fisheye",
    "rolling_shutter": r"([\d.]+) dB with a\s+rolling shutter",
}


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """What the demo writes about the sample. It runs as a user runs it: in a process of its own, in
    single precision, its programs optimised, which those of the tests are not."""
    out = tmp_path_factory.mktemp("demo")
    own = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    command = [sys.executable, "-m", "gaussray", "demo", f"out={out}", "quiet=true"]
    subprocess.run(command, env=own, check=True)
    return json.loads((out / "report.json").read_text())


@pytest.mark.slow
@pytest.mark.parametrize("effect", EFFECTS)
def test_the_sample_reaches_the_figures_of_the_readme(report, effect):
    stated = re.search(EFFECTS[effect], README.read_text())
    assert stated, f"the README states no figure for {effect}"
    assert report["effects"][effect]["psnr"] == pytest.approx(float(stated[1]), abs=TOLERANCE)
