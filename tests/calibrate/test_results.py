"""Results of a calibration: unknowns without effect, PSNR, the printed table."""

import numpy as np
import pytest

from gaussray.calibrate.parameters import Unknown
from gaussray.calibrate.results import Label, calibration_table, check_effect, residual_psnr
from gaussray.calibrate.solver import Sums


LABELS = [
    Label(Unknown("focal", "focal", "px", 0), None),
    Label(Unknown("shutter", "readout", "s", 0), None),
    Label(Unknown("pose", "turn.right", "degrees", 0), "cam_1"),
]


def sums(*effect):
    inner = 1000 * np.diag(np.square(effect))
    return Sums(np.full(1000, 0.1, np.float32), np.zeros(3), inner, inner, np.stack([inner] * 2))


def test_what_changes_nothing_is_named_with_the_reason():
    check_effect(sums(1, 1, 1), LABELS)
    message = r"readout has no effect on these pictures \(nothing moves in them\)"
    with pytest.raises(ValueError, match=message):
        check_effect(sums(1, 1e-9, 1), LABELS)
    with pytest.raises(ValueError, match="cam_1 turn.right has no effect .* Leave pose out"):
        check_effect(sums(1, 1, 0), LABELS)


def test_psnr_is_that_of_the_residuals():
    np.testing.assert_allclose(residual_psnr(sums(1, 1, 1)), 20)


def test_the_table_has_a_line_for_every_number():
    error = {"independent": 0.01, "tiles": 0.02}
    row = {"name": "focal", "start": 100.0, "value": 104.5, "standard_error": error, "unit": "px"}
    report = {"parameters": [row], "psnr": {"before": 20.0, "after": 30.0}, "confounded": ["x"]}
    lines = calibration_table(report).splitlines()
    assert lines[1].split() == ["focal", "100", "104.5", "0.01", "0.02", "px"]
    assert lines[2:] == ["PSNR 20.00 -> 30.00 dB", "x"]


def test_numbers_of_the_table_never_touch():
    error = {"independent": 0.0024, "tiles": 0.0061}
    row = {"name": "shift.forward", "start": -0.00123456e-7, "value": -0.000645154}
    report = {"parameters": [{**row, "standard_error": error, "unit": "scene"}]}
    report.update(psnr={"before": 20.0, "after": 30.0}, confounded=[])
    line = calibration_table(report).splitlines()[1]
    assert line.split()[1:3] == ["-1.23456e-10", "-0.000645154"]
