"""The README's headline figures, measured again: `pytest -m slow tests/test_sample_quality.py`."""

import json
import re
from pathlib import Path

import jax
import pytest

from gaussray.cli.main import main
from gaussray.io.sample_data import sample


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
    """The sample capture, reconstructed and scored with the default settings."""
    out = tmp_path_factory.mktemp("sample")
    with jax.enable_x64(False):
        main(["reconstruct", "capture.path=sample", f"out={out}", "quiet=true"])
        main(["evaluate", f"scene={out}", "truth=sample", "evaluate.images=false", "quiet=true"])
    return json.loads((out / "evaluation" / "report.json").read_text())


@pytest.mark.slow
@pytest.mark.parametrize("effect", EFFECTS)
def test_the_sample_reaches_the_figures_of_the_readme(report, effect):
    assert sample("capture").is_dir()
    stated = re.search(EFFECTS[effect], README.read_text())
    assert stated, f"the README states no figure for {effect}"
    assert report["effects"][effect]["psnr"] >= float(stated[1]) - TOLERANCE
