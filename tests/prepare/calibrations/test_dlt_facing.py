"""DLTs of which the sign is free, and those of mirrored pictures."""

import numpy as np
import pytest
from quads import arc, looking

from gaussray.prepare.calibrations.dlt_facing import check_dlts
from gaussray.prepare.calibrations.projections import dlt_projection
from gaussray.prepare.calibrations.read import read_calibration
from gaussray.prepare.errors import PrepareError


MATRIX = np.array([[700.0, 0, 320.25], [0, 702.0, 240.5], [0, 0, 1]])
ROWS = 480
UPWARD = np.array([[1.0, 0, 0], [0, -1, ROWS - 1], [0, 0, 1]])
# The origin of the world is before these cameras, behind those, or before one of two.
BEFORE = arc(4)
BEHIND = [looking((x, 1.0, 1.0), (0, 5, 1)) for x in (-1.5, 0.5, 1.5)]
MIXED = [looking((-1.0, 0.5, 1), (0, 5, 1)), looking((1.0, -0.5, 1), (0, 5, 1))]
CLOSE = 1e-9


def table(poses, flip=None):
    flip = np.eye(3) if flip is None else flip
    found = [flip @ MATRIX @ pose for pose in poses]
    return np.array([(one / one[2, 3]).ravel()[:11] for one in found])


def rows(numbers):
    return "".join(",".join(repr(float(x)) for x in row) + "\n" for row in numbers)


def check(cameras, poses):
    for one, pose in zip(cameras, poses, strict=True):
        assert one.pose == pytest.approx(pose, abs=CLOSE)
        assert one.lens["fl_y"] == pytest.approx(702, rel=CLOSE)


def test_an_origin_behind_the_camera_changes_nothing():
    pose = np.column_stack([np.eye(3), [0.0, 0, -1]])
    (numbers,) = table([pose])
    assert dlt_projection(numbers) == pytest.approx((MATRIX @ pose).ravel(), abs=CLOSE)
    pose[2, 3] = 1.0
    (numbers,) = table([pose])
    assert dlt_projection(numbers) == pytest.approx((MATRIX @ pose).ravel(), abs=CLOSE)


@pytest.mark.parametrize("poses", [BEFORE, BEHIND, MIXED])
def test_origins_before_and_behind_cameras_are_read(tmp_path, capsys, poses):
    for text in (rows(table(poses)), rows(table(poses).T)):
        (tmp_path / "rig.csv").write_text(text)
        check(read_calibration(tmp_path).cameras, poses)
        assert "rows of a DLT are taken to count from the top" in capsys.readouterr().out
    (tmp_path / "rig.csv").unlink()
    for k, numbers in enumerate(table(poses)):
        (tmp_path / f"cam{k}.txt").write_text(rows([numbers]))
    check(read_calibration(tmp_path).cameras, poses)


@pytest.mark.parametrize("poses", [BEFORE, BEHIND, MIXED])
@pytest.mark.parametrize("alone", [False, True])
def test_rows_from_the_bottom_turn_cameras_away_and_are_told(tmp_path, poses, alone):
    upward = table(poses, UPWARD)

    def write(numbers):
        for k, one in enumerate(numbers) if alone else [("", numbers)]:
            (tmp_path / f"cam{k}.csv").write_text(rows([one] if alone else one))

    write(upward)
    with pytest.raises(
        PrepareError, match=f"one thing, got {len(poses)} that look away .* before 8"
    ):
        read_calibration(tmp_path)
    # The remedy, as the message says it.
    third = np.column_stack([upward[:, 8:], np.ones(len(poses))])
    upward[:, 4:8] = (ROWS - 1) * third - upward[:, 4:8]
    write(upward)
    check(read_calibration(tmp_path).cameras, poses)


def test_cameras_that_do_look_away_are_read_from_twelve_numbers(tmp_path):
    poses = [looking((x, 0, 1), (5 * x, 0, 2)) for x in (-1.0, 1.0)]
    (tmp_path / "rig.csv").write_text(rows(table(poses)))
    with pytest.raises(PrepareError, match="If they do look away, write 12 numbers of each"):
        read_calibration(tmp_path)
    whole = [dlt_projection(one) for one in table(poses)]
    (tmp_path / "rig.csv").write_text(rows(whole))
    check(read_calibration(tmp_path).cameras, poses)


def test_one_camera_and_parallel_ones_tell_nothing(capsys):
    ahead = np.eye(3, 4)
    beside = np.column_stack([np.eye(3), [1.0, 0, 0]])
    for poses in ([], [ahead], [ahead, beside], [ahead, ahead]):
        check_dlts("a.csv", poses)
        assert ("L5 to L8: (rows" in capsys.readouterr().out) == bool(poses)
