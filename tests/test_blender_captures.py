"""The generator of moving scenes with Blender itself: a capture that is whole, and resuming."""

import subprocess
from pathlib import Path

import numpy as np
import pytest

from experiments.captures.moving import moving_pixels
from experiments.paired_benchmark.geometry.proof import PYTHON_KEY, blender_python
from gaussray.capture.formats.paired import read_capture
from gaussray.capture.frames import read_encoded
from gaussray.capture.view_file import check_images
from gaussray.evaluate.masks import MotionMasks


ROOT = Path(__file__).parents[1]
SMALL = ["--size", "32", "--cameras", "5", "--held-cameras", "1", "--frames", "5"]
SMALL += ["--samples", "2", "--truth-samples", "2"]
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        blender_python() is None, reason=f"needs {PYTHON_KEY} to name a Python that has bpy"
    ),
]


def generate(out, *words):
    """Exit code and output of the command."""
    command = [blender_python(), "-m", "experiments.captures.soft_scenes", "soft_two"]
    command += ["--out", str(out), *SMALL, *words]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    return done.returncode, done.stdout + done.stderr


def files(out):
    return {
        str(path.relative_to(out)): path.read_bytes() for path in out.rglob("*") if path.is_file()
    }


def test_a_capture_is_whole_moves_and_is_the_same_after_a_stop(tmp_path):
    code, said = generate(tmp_path)
    assert code == 0, said
    whole = files(tmp_path)
    capture = read_capture(tmp_path / "soft_two")
    check_images(capture.views)
    held_out = [view for view in capture.views if view.split == "test"]
    assert capture.points is not None and (len(capture.views), len(held_out)) == (28, 8)
    trained = {view.time for view in capture.views if view.split == "train"}
    assert sorted(view.time for view in held_out if view.time not in trained) == [
        0.375,
        0.625,
        0.875,
    ]
    first = np.stack([read_encoded(v) for v in capture.views if v.camera_name == "cam00"]) / 255.0
    assert (np.ptp(first, axis=0).max(axis=-1) > 0.2).mean() > 0.02

    # The last picture of a session, and one in its middle, rendered in a session of their own.
    for name in ("images/cam04/03.5.jpg", "images/cam02/03.jpg", "points3d.ply"):
        (tmp_path / "soft_two" / name).unlink()
    code, said = generate(tmp_path)
    assert code == 0, said
    assert files(tmp_path) == whole

    code, said = generate(tmp_path, "--samples", "3")
    assert code != 0 and "written with other settings" in said


def test_cameras_that_move_come_with_held_out_pictures_of_what_stands_still_alone(tmp_path):
    code, said = generate(tmp_path, "--rig", "moving", "--samples", "4", "--truth-samples", "4")
    assert code == 0, said
    held = [v for v in read_capture(tmp_path / "soft_two_moving").views if v.split == "test"]
    masks = MotionMasks(held)
    assert len(held) == 8
    shares = np.array([moving_pixels(masks, view).mean() for view in held])
    assert np.all(shares < 0.9) and np.median(shares) > 0.02


def test_of_a_camera_that_moves_alone_each_fifth_picture_is_held_out(tmp_path):
    code, said = generate(tmp_path, "--rig", "walk", "--frames", "10")
    assert code == 0, said
    views = read_capture(tmp_path / "soft_two_walk").views
    assert [k for k, view in enumerate(views) if view.split == "test"] == [2, 7]
    assert len({view.camera_name for view in views}) == 1
    assert sorted(view.time for view in views) == [view.time for view in views]
    eye = np.array([view.camera.trajectory.translation[0] for view in views])
    assert np.all(np.linalg.norm(np.diff(eye, axis=0), axis=1) > 0)
