"""Files of OpenCV's FileStorage: stereo calibrations are read, others named and refused."""

import re

import numpy as np
import pytest

from gaussray.prepare.calibrations.opencv_storage import is_storage, stereo_storages
from gaussray.prepare.calibrations.read import read_calibration
from gaussray.prepare.errors import PrepareError


MATRIX = np.array([[500.0, 0, 310.25], [0, 505.0, 242.5], [0, 0, 1]])
# As the sample writes them: rational distortion, of which it keeps k1, k2 and k6.
RATIONAL = np.array([[-0.05, 0.02, 0, 0, 0, 0, 0, 0.3, 0, 0, 0, 0, 0, 0]])
R = np.array([[1.0, 0, 0], [0, 0.8, -0.6], [0, 0.6, 0.8]])
T = np.array([[-0.4], [0.02], [0.1]])
INNER = {"M1": MATRIX, "D1": RATIONAL, "M2": MATRIX + np.diag([10, 10, 0]), "D2": np.zeros((1, 5))}
OUTER = {"R": R, "T": T, "R1": np.eye(3), "R2": R, "P1": np.eye(3, 4), "Q": np.eye(4)}
HEAD = "%YAML:1.0\n---\n"


def as_yaml(values):
    text = HEAD
    for key, value in values.items():
        rows, cols = value.shape
        data = ", ".join(f"{x:.17g}" if x else "0." for x in value.ravel())
        text += f"{key}: !!opencv-matrix\n   rows: {rows}\n   cols: {cols}\n   dt: d\n"
        text += f"   data: [ {data} ]\n"
    return text


def as_xml(values):
    text = '<?xml version="1.0"?>\n<opencv_storage>\n'
    for key, value in values.items():
        rows, cols = value.shape
        data = " ".join(f"{x:.17g}" for x in value.ravel())
        text += f'<{key} type_id="opencv-matrix">\n  <rows>{rows}</rows>\n  <cols>{cols}</cols>\n'
        text += f"  <dt>d</dt>\n  <data>\n    {data}</data></{key}>\n"
    return text + "</opencv_storage>\n"


def check(calibration):
    first, second = calibration.cameras
    assert calibration.is_pair and (first.name, second.name) == ("left", "right")
    assert np.array_equal(first.pose, np.eye(3, 4))
    assert np.array_equal(second.pose, np.hstack([R, T]))
    assert (first.lens["fl_x"], first.lens["cx"]) == (500, 310.75)
    assert (first.lens["k1"], first.lens["k3"], first.lens["k6"]) == (-0.05, 0, 0.3)
    assert (second.lens["fl_y"], second.lens["cy"], second.lens["w"]) == (515, 243, 0)


@pytest.mark.parametrize("write", [as_yaml, as_xml])
@pytest.mark.parametrize(
    ("inner", "outer"),
    [("intrinsics", "extrinsics"), ("Intrinsic", "Extrinsic"), ("intri", "extri")],
)
def test_the_pair_is_read_by_folder_and_by_either_file(tmp_path, write, inner, outer):
    suffix = ".yml" if write is as_yaml else ".xml"
    (tmp_path / f"{inner}{suffix}").write_text(write(INNER))
    (tmp_path / f"{outer}{suffix}").write_text(write(OUTER))
    # The sample's list of pictures.
    (tmp_path / "stereo_calib.xml").write_text(
        '<?xml version="1.0"?>\n<opencv_storage><imagelist>a.jpg</imagelist></opencv_storage>\n'
    )
    for place in (tmp_path, tmp_path / f"{inner}{suffix}", tmp_path / f"{outer}{suffix}"):
        check(read_calibration(place))


@pytest.mark.parametrize("write", [as_yaml, as_xml])
def test_one_file_may_hold_all(tmp_path, write):
    path = tmp_path / ("extrinsics.yml" if write is as_yaml else "rig.xml")
    path.write_text(write(INNER | OUTER))
    check(read_calibration(path))
    check(read_calibration(tmp_path))
    # The lenses of another calibration beside it are of no account.
    (tmp_path / "intrinsics.yml").write_text(as_yaml(INNER | {"M1": 2 * MATRIX}))
    assert stereo_storages(tmp_path) == [path]
    check(read_calibration(tmp_path))


def test_a_translation_may_be_a_list_and_keys_of_other_names(tmp_path):
    names = dict(zip(INNER, ("mtxL", "distL", "mtxR", "distR"), strict=True))
    text = as_yaml({names[key]: value for key, value in INNER.items()} | {"R": R})
    path = tmp_path / "calib.yaml"
    path.write_text(text + "T: [ -4.0e-01, 2.0e-02,\n    1.0e-01 ]\n")
    check(read_calibration(path))
    path = tmp_path / "calib.xml"
    text = as_xml(INNER | {"R": R}).replace("</opencv_storage>", "<T>-0.4 2e-2 0.1</T>")
    path.write_text(text + "</opencv_storage>")
    check(read_calibration(path))


@pytest.mark.parametrize("write", [as_yaml, as_xml])
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"M2": None}, "two camera matrices"),
        ({"D1": None}, "two distortion coefficients (D1 and D2,"),
        ({"R": np.eye(2)}, "R must be 9 or 3 finite numbers, got 4"),
        ({"R": -np.eye(3)}, "R must be a rotation without a reflection"),
        ({"M1": MATRIX * np.nan}, "M1 must be 9 finite numbers, got [nan"),
        ({"T": 0 * T}, "T must not be zero"),
    ],
)
def test_a_wrong_value_is_named(tmp_path, write, change, message):
    values = {k: v for k, v in (INNER | OUTER | change).items() if v is not None}
    path = tmp_path / ("a.yml" if write is as_yaml else "a.xml")
    path.write_text(write(values).replace("nan", ".Nan"))
    with pytest.raises(PrepareError, match=re.escape(message)) as told:
        read_calibration(path)
    assert str(told.value).startswith(str(path))


def test_what_the_other_file_has_must_be_there(tmp_path):
    path = tmp_path / "intrinsics.yml"
    path.write_text(as_yaml(INNER))
    with pytest.raises(PrepareError, match="hold all of R and T, or extrinsics.yml must be b"):
        read_calibration(path)
    with pytest.raises(PrepareError, match="hold all of R and T, or extrinsics.yml must be b"):
        read_calibration(tmp_path)
    path.unlink()
    path = tmp_path / "stereo_extrinsics.yml"
    path.write_text(as_yaml(OUTER))
    with pytest.raises(PrepareError, match="all of M1, D1, M2 and D2, or stereo_intrinsics.yml"):
        read_calibration(path)
    path = path.rename(tmp_path / "poses.yml")
    with pytest.raises(PrepareError, match="poses.yml: must hold two camera matrices .* got R, T,"):
        read_calibration(path)
    (tmp_path / "extrinsics.yml").write_text(as_yaml({"R1": R}))
    (tmp_path / "intrinsics.yml").write_text(as_yaml(INNER))
    with pytest.raises(PrepareError, match="intrinsics.yml with extrinsics.yml: must hold the ro"):
        read_calibration(tmp_path / "intrinsics.yml")


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.yml", as_yaml(INNER | OUTER)[:900]),
        ("a.xml", as_xml(INNER | OUTER)[:900]),
        ("a.yml", as_yaml({"camera_matrix": MATRIX, "distortion_coefficients": RATIONAL})),
        ("a.xml", as_xml({"camera_matrix": MATRIX, "distortion_coefficients": RATIONAL})),
    ],
)
def test_truncated_files_and_other_keys_are_told_what_is_read(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    with pytest.raises(
        PrepareError, match=f"{name}: .* Write a file for each camera with CameraMatrix"
    ):
        read_calibration(tmp_path / name)


def test_other_files_are_no_storage(tmp_path):
    for name, text in (("a.yaml", "cam0: {}"), ("a.xml", "<document/>"), ("a.txt", HEAD)):
        (tmp_path / name).write_text(text)
        assert not is_storage(tmp_path / name)
    (tmp_path / "a.yaml").write_text(HEAD)
    assert is_storage(tmp_path / "a.yaml") and stereo_storages(tmp_path) == []


def test_of_files_of_opencv_one_with_a_camera_is_named_and_the_conventions(tmp_path):
    def put(name, *shapes):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        sizes = "".join(f"<rows>{r}</rows>\n  <cols>{c}</cols>" for r, c in shapes)
        text = f'<?xml version="1.0"?>\n<opencv_storage>{sizes}</opencv_storage>'
        (tmp_path / name).write_text(text)

    def named():
        with pytest.raises(PrepareError, match="with CameraMatrix, .* lists all kinds") as e:
            read_calibration(tmp_path)
        return str(e.value).split(": must")[0]

    put("checkerboard.xml")
    put("cam1/corners.xml", (88, 2))
    put("cam1/intrinsics.xml", (3, 3), (1, 5))
    assert named().endswith("cam1/intrinsics.xml")
    put("cam1/config.xml", (3, 3), (1, 5), (3, 1), (3, 1))
    assert named().endswith("cam1/config.xml")


def test_four_coefficients_of_a_file_called_fisheye_are_of_that_model(tmp_path, capsys):
    lenses = INNER | {"D1": np.array([[0.1, 0.2, 0.3, 0.4]]), "D2": np.zeros((1, 4))}
    path = tmp_path / "fisheye_stereo.yml"
    path.write_text(as_yaml(lenses | OUTER))
    first, second = read_calibration(path).cameras
    assert {x.lens["camera_model"] for x in (first, second)} == {"OPENCV_FISHEYE"}
    assert first.lens["k4"] == 0.4 and "OpenCV's fisheye model" in capsys.readouterr().out


@pytest.mark.parametrize("rows", [".inf", "9" * 400, "[" * 3000])
def test_rows_of_no_count_are_told_and_no_calibration_beside_fails(tmp_path, rows):
    path = tmp_path / "board.yml"
    path.write_text(f"{HEAD}R: !!opencv-matrix\n   rows: {rows}\n   cols: 3\n   data: [ 1. ]\n")
    with pytest.raises(PrepareError, match=r"board.yml: must be YAML of OpenCV"):
        read_calibration(path)
    (tmp_path / "intrinsics.yml").write_text(as_yaml(INNER | OUTER))
    check(read_calibration(tmp_path))
