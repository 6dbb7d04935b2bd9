"""Text files of camera matrices: KRT files, and 3 x 4 projections."""

import numpy as np
import pytest
from quads import arc

from gaussray.prepare.calibrations.lens_file import read_lenses
from gaussray.prepare.calibrations.read import read_calibration
from gaussray.prepare.errors import PrepareError


POSES = arc(3)
NAMES = ("400002", "400004", "400007")
MATRIX = np.array([[7000.0, 0, 690.25], [0, 7020.0, 1010.5], [0, 0, 1]])
FIVE = [-0.05, 0.02, 0.001, -0.002, 0.003]
CLOSE = 1e-9


def rows(matrix):
    return "".join(" ".join(repr(float(x)) for x in row) + "\n" for row in matrix)


def krt(name, pose, dist=FIVE, **changes):
    """A block as Neural Volumes and Multiface write it, in millimetres."""
    matrix = changes.get("K", MATRIX)
    pose = np.column_stack([pose[:, :3], 1000 * pose[:, 3]])
    return f"{name}\n{rows(matrix)}{rows([dist])}{rows(pose)}\n"


def write(path, text):
    path.write_text(text)
    return path


@pytest.mark.parametrize("name", ["KRT", "KRT.txt", "rig.krt", "krt2"])
@pytest.mark.parametrize("dist", [FIVE, [0] * 5, FIVE[:4]])
def test_krt(tmp_path, capsys, name, dist):
    blocks = zip(NAMES, POSES, strict=True)
    path = write(tmp_path / name, "".join(krt(one, pose, dist) for one, pose in blocks))
    cameras = read_calibration(path).cameras
    assert [one.name for one in cameras] == list(NAMES)
    for one, pose in zip(cameras, POSES, strict=True):
        assert one.pose[:, :3] == pytest.approx(pose[:, :3], abs=CLOSE)
        assert one.pose[:, 3] == pytest.approx(1000 * pose[:, 3], abs=CLOSE)
        found = [one.lens.get(key, 0) for key in ("fl_x", "fl_y", "cx", "cy", "k1", "p2", "k3")]
        k3 = dist[4] if len(dist) == 5 else 0
        assert found == pytest.approx([7000, 7020, 690.75, 1011, dist[0], dist[3], k3], abs=CLOSE)
        assert one.lens["w"] == 0
    told = capsys.readouterr().out
    assert "[R | t] is taken as OpenCV's, from world to camera." in told
    assert "k1 k2 p1 p2 k3 as OpenCV has them, and the unit that of t, which is the mill" in told
    assert read_lenses(path)["400002"] == cameras[0].lens


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("-0.05 0.02 0.001 -0.002 0.003\n", ""), None),
        (("-0.05 0.02 0.001", "0.001"), "dist must be OpenCV's 4, 5 or 8 .* got 3"),
        (
            ("0.0 0.0 1.0\n", ""),
            "line 2 must be the first of three lines of 3 or of 4 .* got 7000",
        ),
        (
            ("7000.0", "nan"),
            "line 2 must be the first of three lines of 3 or of 4 .* got nan 0",
        ),
        (("7000.0 0.0", "7000.0 20.0"), "matrix of camera 400002 must have no skew, got 20 pixels"),
        (("400004", "400002"), "a name of its own, got 400002 twice"),
        (("400004\n", ""), "a line with its name, or none of them, got 400002, 1"),
        (("0.0 0.0 1.0", "0.0 1.0 1.0"), "camera 400002 must end with the row 0 0 1"),
    ],
)
def test_a_wrong_line_of_krt_is_named(tmp_path, change, message):
    text = krt(NAMES[0], POSES[0]) + krt(NAMES[1], POSES[1])
    path = write(tmp_path / "KRT", text.replace(*change, 1))
    if message is None:
        assert [c.lens["k1"] for c in read_calibration(path).cameras] == [0, -0.05]
        return
    with pytest.raises(PrepareError, match=message):
        read_calibration(path)


def test_an_unfinished_krt_is_refused(tmp_path):
    text = krt(NAMES[0], POSES[0]) + krt(NAMES[1], POSES[1])
    path = write(tmp_path / "KRT", text.rstrip().rsplit("\n", 1)[0])
    with pytest.raises(PrepareError, match="line 15 must be the first of three .* of 4 numbers"):
        read_calibration(path)


def projections(scale=1.0):
    return [scale * MATRIX @ pose for pose in POSES]


def check(cameras, names):
    assert [one.name for one in cameras] == list(names)
    for one, pose in zip(cameras, POSES, strict=True):
        assert one.pose == pytest.approx(pose, abs=CLOSE)
        found = [one.lens[key] for key in ("fl_x", "fl_y", "cx", "cy", "k1")]
        assert found == pytest.approx([7000, 7020, 690.75, 1011, 0], rel=CLOSE)


@pytest.mark.parametrize("header", ["", "CONTOUR\n"])
@pytest.mark.parametrize(("name", "called"), [("cam{}", "cam{}"), ("{:02d}_P", "{:02d}")])
@pytest.mark.parametrize("last", ["", "0 0 0 1\n"])
def test_a_projection_for_each_camera(tmp_path, capsys, header, name, called, last):
    for k, matrix in enumerate(projections()):
        path = write(tmp_path / (name.format(k) + ".txt"), header + rows(matrix) + last)
    (tmp_path / "README.txt").write_text("three cameras\n")
    check(read_calibration(tmp_path).cameras, [called.format(k) for k in range(3)])
    told = capsys.readouterr().out
    assert "P is split into K and [R | t], with positive focal lengths; the middle of" in told
    with pytest.raises(PrepareError, match="must hold all cameras, got one"):
        read_calibration(path)


@pytest.mark.parametrize("named", [False, True])
def test_projections_in_one_file(tmp_path, capsys, named):
    names = NAMES if named else ("0", "1", "2")
    text = "".join(
        (f"{name}\n" if named else "\n") + rows(matrix)
        for name, matrix in zip(names, projections(scale=0.01), strict=True)
    )
    check(read_calibration(write(tmp_path / "cameras.txt", text)).cameras, names)
    assert ("3 cameras without a name are called" in capsys.readouterr().out) is not named


def test_other_text_beside_a_calibration_does_not_count(tmp_path):
    blocks = zip(NAMES, POSES, strict=True)
    write(tmp_path / "KRT", "".join(krt(one, pose) for one, pose in blocks))
    # Neural Volumes' place of the object, and a projection.
    write(tmp_path / "pose.txt", rows(POSES[0]) + "1 2 3\n")
    write(tmp_path / "cam0.txt", rows(projections()[0]))
    assert [one.name for one in read_calibration(tmp_path).cameras] == list(NAMES)
    (tmp_path / "KRT").unlink()
    (tmp_path / "pose.txt").unlink()
    text = "".join(map(rows, projections()))
    check(read_calibration(write(tmp_path / "cam0.txt", text).parent).cameras, "012")


def test_k_with_r_and_t_of_one_camera_is_read_from_its_file(tmp_path):
    for k, pose in enumerate(POSES):
        write(tmp_path / f"cam{k}.txt", rows(MATRIX) + rows(pose))
    check(read_calibration(tmp_path).cameras, ["cam0", "cam1", "cam2"])


SKEWED = np.array([[1.0, 0.01, 0], [0, 1, 0], [0, 0, 1]])


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (-MATRIX @ POSES[0], "first three columns of P must have a positive .* got a negative one"),
        (np.diag([1, -1, 1]) @ MATRIX @ POSES[0], "Negate all its 12 numbers if points before"),
        (np.diag([1, 1, 0]) @ MATRIX @ POSES[0], "a positive determinant, got 0. Calibrate it ag"),
        (POSES[0], "a rotation and a translation without K. Write K beside it, and call it RT"),
        (MATRIX @ SKEWED @ POSES[0], "camera 0: P must be a projection without skew, got 70 pix"),
    ],
)
def test_what_is_no_projection_is_told(tmp_path, matrix, message):
    path = write(tmp_path / "cameras.txt", rows(matrix) + rows(projections()[1]))
    with pytest.raises(PrepareError, match=message):
        read_calibration(path)
    (tmp_path / "cameras.txt").rename(tmp_path / "cam0.txt")
    write(tmp_path / "cam0.txt", rows(matrix))
    write(tmp_path / "cam1.txt", rows(projections()[1]))
    with pytest.raises(PrepareError, match=message.replace("camera 0", "cam0.txt")):
        read_calibration(tmp_path)


def test_slight_skew_is_left_out_with_a_line(tmp_path, capsys):
    skew = np.array([[1.0, 1e-4, 0], [0, 1, 0], [0, 0, 1]])
    matrices = [MATRIX @ skew @ pose for pose in POSES]
    cameras = read_calibration(write(tmp_path / "P.txt", "".join(map(rows, matrices)))).cameras
    assert cameras[1].pose == pytest.approx(POSES[1], abs=CLOSE)
    assert (
        "Skew is left out, which costs at most 0.1 pixels at the border." in capsys.readouterr().out
    )


@pytest.mark.parametrize("text", ["", "1 2 3\n", "a\nb\nc\n1 2 3 4\n", "1 2 3 4\n5 6 7 8\n"])
def test_other_text_files_are_no_calibrations(tmp_path, text):
    with pytest.raises(PrepareError, match="of a kind that is read, got .txt"):
        read_calibration(write(tmp_path / "a.txt", text))


@pytest.mark.parametrize("name", ["KRT", "a.krt"])
@pytest.mark.parametrize("text", ["", "\n \n"])
def test_an_empty_file_is_told(tmp_path, name, text):
    path = write(tmp_path / name, text)
    with pytest.raises(PrepareError, match="must hold the numbers of a camera, got no line"):
        read_calibration(path)


def flat(matrix, count=12, gap=","):
    """A projection in one line, divided by its last number."""
    return gap.join(repr(float(x)) for x in (matrix / matrix[2, 3]).ravel()[:count]) + "\n"


@pytest.mark.parametrize("count", [11, 12])
@pytest.mark.parametrize(("suffix", "gap"), [(".csv", ","), (".csv", ", "), (".txt", " ")])
def test_a_projection_in_one_line_of_each_camera(tmp_path, count, suffix, gap):
    for k, matrix in enumerate(projections()):
        path = write(tmp_path / f"view{k}{suffix}", flat(matrix, count, gap))
    write(tmp_path / "track.csv", ",0,1,2\n0,50.0,111.0,105.0\n")
    check(read_calibration(tmp_path).cameras, ["view0", "view1", "view2"])
    with pytest.raises(PrepareError, match="must hold all cameras, got one"):
        read_calibration(path)
    path = write(tmp_path / f"rig{suffix}", "".join(flat(one, count, gap) for one in projections()))
    check(read_calibration(path).cameras, "012")
    named = "".join(f"{n}\n" + flat(m) for n, m in zip(NAMES, projections(), strict=True))
    check(read_calibration(write(path, named)).cameras, NAMES)


def test_columns_are_the_coefficients_of_cameras_in_order(tmp_path, capsys):
    columns = np.array([(one / one[2, 3]).ravel()[:11] for one in projections()]).T
    text = "".join(",".join(repr(float(x)) for x in row) + "\n" for row in columns)
    calibration = read_calibration(write(tmp_path / "DLTcoefs.csv", text))
    check(calibration.cameras, "012")
    assert calibration.in_order
    assert "each column has the 11 coefficients of a camera (DLT)" in capsys.readouterr().out
    # A file of one camera has one column.
    (tmp_path / "DLTcoefs.csv").unlink()
    for k in range(3):
        write(tmp_path / f"cam{k}_dlt.csv", "".join(f"{x!r}\n" for x in columns[:, k].tolist()))
    check(read_calibration(tmp_path).cameras, [f"cam{k}_dlt" for k in range(3)])


def test_a_table_that_is_no_projection_is_told_how_one_is_written(tmp_path):
    path = write(tmp_path / "track.csv", ",0,1\n0,50.0,111.0\n")
    with pytest.raises(PrepareError, match="got .csv. Write .*Or as text: .* or its 12 numbers"):
        read_calibration(path)


def test_rows_that_count_from_the_bottom_and_skew_are_told_how_to_mend(tmp_path):
    height, matrix = 2048, projections()[0]
    upward = matrix.copy()
    upward[1] = (height - 1) * matrix[2] - matrix[1]
    path = write(tmp_path / "rig.csv", flat(upward) + flat(projections()[1]))
    with pytest.raises(PrepareError, match="rows count from the bottom .* the third one minus the"):
        read_calibration(path)
    upward[1] = (height - 1) * upward[2] - upward[1]
    write(path, flat(upward) + flat(projections()[1]))
    assert read_calibration(path).cameras[0].lens["cy"] == pytest.approx(1011, rel=CLOSE)
    write(path, flat(MATRIX @ SKEWED @ POSES[0]) + flat(projections()[1]))
    with pytest.raises(PrepareError, match="if 10 pixels 1010 rows from row 1010 do not matter"):
        read_calibration(path)
