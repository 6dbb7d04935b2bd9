"""Tables of the coefficients of DLTs: a camera in each column or line."""

import numpy as np
import pytest
from quads import arc

from gaussray.prepare.calibrations.assign import assign_cameras
from gaussray.prepare.calibrations.read import read_calibration
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.sources import Source


MATRIX = np.array([[7000.0, 0, 690.25], [0, 7020.0, 1010.5], [0, 0, 1]])
CLOSE = 1e-8


def coefficients(count, matrix=MATRIX, poses=None):
    """L1 to L11 of each of some cameras [camera, 11]."""
    found = [matrix @ pose for pose in (arc(count) if poses is None else poses)]
    return np.array([(one / one[2, 3]).ravel()[:11] for one in found])


def lines(table, names=None):
    """A table as text, with a name in each line."""
    rows = [",".join(repr(float(x)) for x in row) for row in table]
    if names is not None:
        rows = [f"{name},{row}" for name, row in zip(names, rows, strict=True)]
    return "\n".join(rows) + "\n"


def write(path, text):
    path.write_text(text)
    return path


def check(calibration, names):
    """The cameras are those of the arc, in this order."""
    assert [one.name for one in calibration.cameras] == list(names)
    for one, pose in zip(calibration.cameras, arc(len(names)), strict=True):
        assert one.pose == pytest.approx(pose, abs=CLOSE)
        assert one.lens["fl_x"] == pytest.approx(7000, rel=CLOSE)


def cams(count):
    return [f"cam{k}" for k in range(1, count + 1)]


@pytest.mark.parametrize("count", [3, 11, 12, 13])
@pytest.mark.parametrize("labels", [False, True])
def test_a_line_of_names_above_columns(tmp_path, count, labels):
    names = [f"L{k}" for k in range(1, 12)] if labels else None
    head = ("coefficient," if labels else "") + ",".join(cams(count))
    text = f"{head}\n{lines(coefficients(count).T, names)}"
    calibration = read_calibration(write(tmp_path / "rig.csv", text))
    check(calibration, cams(count))
    assert not calibration.in_order


def test_columns_with_names_may_have_more_cameras_than_the_input(tmp_path):
    text = "back 1,side 2,front 3\n" + lines(coefficients(3).T)
    calibration = read_calibration(write(tmp_path / "rig.csv", text))
    check(calibration, ["back 1", "side 2", "front 3"])
    sources = [
        Source(name, tmp_path / f"{name}.mp4", (), np.zeros(3), ((1380, 2020),))
        for name in ("front 3", "side 2")
    ]
    assert set(assign_cameras(calibration, sources)[0]) == {"front 3", "side 2"}
    write(tmp_path / "rig.csv", lines(coefficients(3).T))
    with pytest.raises(PrepareError, match="got 2 cameras there.* a line cam1,cam2 above the col"):
        assign_cameras(read_calibration(tmp_path / "rig.csv"), sources)
    write(tmp_path / "rig.csv", "a,b,a\n" + lines(coefficients(3).T))
    with pytest.raises(PrepareError, match="a name of its own, got a twice"):
        read_calibration(tmp_path / "rig.csv")


@pytest.mark.parametrize("count", [11, 12])
def test_lines_and_columns_that_cannot_be_told_apart_are_refused(tmp_path, count):
    path = write(tmp_path / "rig.csv", lines(coefficients(count).T))
    with pytest.raises(PrepareError, match=f"11 lines of {count} numbers must say whether"):
        read_calibration(path)
    # More or fewer columns are told apart, and have an order.
    write(path, lines(coefficients(13).T))
    assert read_calibration(path).in_order
    write(path, lines(coefficients(11)))
    with pytest.raises(PrepareError, match="Write the name of each camera before its line"):
        read_calibration(path)
    check(read_calibration(write(path, lines(coefficients(11), cams(11)))), cams(11))


@pytest.mark.parametrize(
    "head",
    [
        ",".join(f"L{k}" for k in range(1, 12)),
        ",".join(f"p{k}" for k in range(11)),
        "P11,P12,P13,P14,P21,P22,P23,P24,P31,P32,P33",
    ],
)
@pytest.mark.parametrize("count", [3, 11])
def test_a_header_of_coefficients_is_no_name(tmp_path, head, count):
    path = write(tmp_path / "rig.csv", f"{head}\n{lines(coefficients(count))}")
    check(read_calibration(path), [str(k) for k in range(count)])
    for first in ("name,", ","):
        write(path, f"{first}{head}\n{lines(coefficients(count), range(7, 7 + count))}")
        check(read_calibration(path), [str(k) for k in range(7, 7 + count)])


@pytest.mark.parametrize("last", [False, True])
@pytest.mark.parametrize("names", [["a", "b", "c"], ["cam 1", "cam 2", "cam 3"]])
def test_the_name_may_stand_before_the_numbers_of_its_line(tmp_path, last, names):
    table = coefficients(3)
    if last:
        table = np.column_stack([table, np.ones(3)])
    check(read_calibration(write(tmp_path / "rig.csv", lines(table, names))), names)
    rows = "\n".join(
        f'"{name}";{row}' for name, row in zip(names, lines(table).split(), strict=True)
    )
    check(read_calibration(write(tmp_path / "rig.csv", rows)), names)


RNG = np.random.default_rng(0)


@pytest.mark.parametrize(
    "column",
    [
        np.arange(11) / 30,
        np.arange(11) / 30 + RNG.normal(0, 1e-3, 11),
        np.arange(11.0)[::-1],
        2.0 ** np.arange(11),
        RNG.random(11),
        np.full(11, 1e300),
        np.zeros(11),
    ],
)
@pytest.mark.parametrize("head", ["", "time\n"])
def test_eleven_other_numbers_are_no_camera(tmp_path, column, head):
    path = write(tmp_path / "times.txt", head + lines(column[:, None]))
    with pytest.raises(PrepareError, match="of a kind that is read, got .txt"):
        read_calibration(path)
    for name, one in zip(cams(3), coefficients(3), strict=True):
        write(tmp_path / f"{name}.csv", f"{name}\n{lines(one[:, None])}")
    # Points that were digitized, three numbers each.
    write(tmp_path / "points.csv", lines(np.random.default_rng(1).random((11, 3))))
    check(read_calibration(tmp_path), cams(3))


def test_skew_of_a_dlt_is_mended_by_the_numbers_that_the_message_says(tmp_path):
    skewed = MATRIX + [[0, 70.0, 0], [0, 0, 0], [0, 0, 0]]
    table = np.where([[True], [False], [True]], coefficients(3, skewed), coefficients(3))
    path = write(tmp_path / "rig.csv", lines(table, cams(3)))
    with pytest.raises(PrepareError, match="camera cam1: P .DLT. must be a .* without skew") as e:
        read_calibration(path)
    first, third = str(e.value).split(" So has camera cam3 (10 pixels 1010 rows from row 1010): ")
    found = first.split("row by row, ")[1].rstrip("."), third.removeprefix("write ").rstrip(".")
    numbers = [list(map(float, one.split())) for one in found]
    assert np.array(numbers) == pytest.approx(coefficients(3)[[0, 2]], rel=1e-9)
    table[[0, 2]] = numbers
    check(read_calibration(write(path, lines(table, cams(3)))), cams(3))
