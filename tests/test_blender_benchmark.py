"""The benchmark's generator with Blender itself: shards, resuming, and a capture that is whole."""

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest

from experiments.paired_benchmark.geometry.proof import PYTHON_KEY, blender_python
from gaussray.capture.formats.paired import read_capture
from gaussray.capture.picture_file import read_stored
from gaussray.capture.view_file import check_images


ROOT = Path(__file__).parents[1]
SMALL = ["--scenes", "bathroom_box", "--size", "32", "--cameras", "5", "--frames", "4"]
SMALL += ["--held-cameras", "1", "--held-frames", "1", "--samples", "2", "--truth-samples", "2"]
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        blender_python() is None, reason=f"needs {PYTHON_KEY} to name a Python that has bpy"
    ),
]


def generate(out, *words):
    """Exit code and what was said."""
    command = [blender_python(), "-m", "experiments.paired_benchmark.generate", "--out", str(out)]
    done = subprocess.run([*command, *SMALL, *words], cwd=ROOT, capture_output=True, text=True)
    return done.returncode, done.stdout + done.stderr


def files(out):
    return {
        str(path.relative_to(out)): path.read_bytes() for path in out.rglob("*") if path.is_file()
    }


def test_shards_make_the_same_capture_as_one_run_and_a_run_goes_on_where_it_stopped(tmp_path):
    code, said = generate(tmp_path / "one")
    assert code == 0, said
    whole = files(tmp_path / "one")
    capture = read_capture(tmp_path / "one" / "bathroom_box")
    check_images([*capture.views, *(view for some in capture.effects.values() for view in some)])
    assert capture.points is not None and len(capture.views) == 20

    code, said = generate(tmp_path / "two", "--shard", "1/2")
    assert code == 0 and "other shards" in said, said
    code, said = generate(tmp_path / "two", "--shard", "0/2")
    assert code == 0, said
    assert files(tmp_path / "two") == whole

    lost = ["images/cam00/0000.jpg", "depth/cam04/0001.png", "rolling_shutter/cam04/0002.png"]
    for name in lost:
        (tmp_path / "one" / "bathroom_box" / name).unlink()
    code, said = generate(tmp_path / "one", "--processes", "2")
    assert code == 0, said
    assert files(tmp_path / "one") == whole

    code, said = generate(tmp_path / "one", "--truth-samples", "4")
    assert code != 0 and "written with other settings" in said


def test_depth_is_where_the_starting_points_are(tmp_path):
    code, said = generate(tmp_path)
    assert code == 0, said
    folder = tmp_path / "bathroom_box"
    told = json.loads((folder / "transforms.json").read_text())
    (frame,) = [f for f in told["frames"] if f["camera"] == "cam04" and f["time"] == 0]
    metres = read_stored(folder / frame["depth_file_path"], 32, 32)[..., 0] / 1000
    pose = np.array(frame["transform_matrix"])
    points = np.asarray(read_capture(folder).points.position)
    x, y, z = ((points - pose[:3, 3]) @ pose[:3, :3]).T
    column, row = told["cx"] - told["fl_x"] * x / z, told["cy"] + told["fl_y"] * y / z
    i, j = np.floor(column).astype(int), np.floor(row).astype(int)
    # Near a pixel's middle, where its depth was taken: elsewhere a pixel of 12 cm may see past it.
    near = np.hypot(column - i - 0.5, row - j - 0.5) < 0.1
    near &= (z < 0) & (i >= 0) & (i < 32) & (j >= 0) & (j < 32)
    off = metres[j[near], i[near]] + z[near]
    assert near.sum() > 100
    # What something hides lies behind, so only one sign is an error; edges are the rest. A tenth
    # of a pixel of slanted floor is 2 cm.
    assert np.mean(off < 0.05) > 0.97
    assert np.median(np.abs(off)) < 0.02
