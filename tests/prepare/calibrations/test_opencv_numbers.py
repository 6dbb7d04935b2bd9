"""Numbers under a key: how many, whether finite, whether a rotation."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gaussray.prepare.calibrations.opencv_numbers import checked_rotation, finite_numbers


def test_numbers_of_any_shape_are_in_reading_order():
    assert finite_numbers(np.arange(9).reshape(3, 3), (9,)).tolist() == list(range(9))
    assert finite_numbers([[1], ["2.5"], [3]], (3, 9)).tolist() == [1, 2.5, 3]


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ([1, 2], "must be 3 or 9 finite numbers, got 2$"),
        ([1, np.nan, 2], "must be 3 or 9 finite numbers, got .1.0, nan, 2.0.$"),
        ("x y z", "must be 3 or 9 finite numbers, got x y z$"),
        ([[1], [2, 3]], "must be 3 or 9 finite numbers, got .*2, 3"),
        (None, "must be 3 or 9 finite numbers, got"),
    ],
)
def test_other_numbers_are_told(value, message):
    with pytest.raises(ValueError, match=message):
        finite_numbers(value, (3, 9))


def test_a_rotation_is_kept_and_what_is_none_refused():
    turn = Rotation.from_rotvec([0.1, -0.2, 0.3]).as_matrix()
    assert np.array_equal(checked_rotation(turn.ravel()), turn)
    with pytest.raises(ValueError, match="rows of length 1, at right angles"):
        checked_rotation(1.01 * turn.ravel())
    with pytest.raises(ValueError, match="without a reflection"):
        checked_rotation(-turn.ravel())
