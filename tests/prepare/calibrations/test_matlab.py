"""Files of MATLAB are refused with the lines that export them, and what these write is read."""

import json

import numpy as np
import pytest

from gaussray.prepare.calibrations.matlab import MATLAB_SNIPPET
from gaussray.prepare.calibrations.read import read_calibration
from gaussray.prepare.errors import PrepareError


def test_a_mat_file_is_refused_with_the_lines_that_export_it(tmp_path):
    path = tmp_path / "stereoParams.mat"
    path.write_bytes(b"MATLAB 5.0 MAT-file")
    for place in (path, tmp_path):
        with pytest.raises(PrepareError, match="stereoParams.mat: must not be a .mat file") as told:
            read_calibration(place)
        assert str(told.value).endswith(MATLAB_SNIPPET)


def test_what_the_lines_write_is_read(tmp_path):
    matrix = [[500.0, 0, 310.25], [0, 505.0, 242.5], [0, 0, 1]]
    shared = {"K": matrix, "dist": [-0.05, 0.02, 0.001, -0.002, 0.01], "size": [640, 480]}
    content = {
        "left": {**shared, "R": np.eye(3).tolist(), "t": [0, 0, 0]},
        "right": {**shared, "R": np.diag([1, -1, -1]).tolist(), "t": [-0.4, 0.02, 0.1]},
    }
    (tmp_path / "stereo.json").write_text(json.dumps(content))
    # A .mat file beside it is of no account.
    (tmp_path / "stereoParams.mat").write_bytes(b"MATLAB 5.0 MAT-file")
    left, right = read_calibration(tmp_path).cameras
    assert (left.name, right.name, left.lens["w"]) == ("left", "right", 640)
    assert right.pose[:, 3].tolist() == [-0.4, 0.02, 0.1]
    # The names of keys in the lines are those of this file.
    for key in (*shared, "R", "t"):
        assert MATLAB_SNIPPET.count(f"'{key}',") == 2
    assert "c.left" in MATLAB_SNIPPET and "c.right" in MATLAB_SNIPPET
