"""Captures of EuRoC: cameras of one body, whose trajectory has a table of its own."""

import numpy as np
import pytest
from known_photograph import (
    PIXELS,
    PLACE,
    TURN,
    H,
    W,
    distorted,
    fisheye,
    pixels,
    seen_points,
    write_picture,
)
from scipy.spatial.transform import Rotation

from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.formats.euroc import euroc_near_miss, read_euroc
from gaussray.capture.open import format_of, open_capture


QUAT = Rotation.from_matrix(TURN).as_quat()[[3, 0, 1, 2]]
FIRST, STEP = 1_403_636_579_763_555_584, 50_000_000
# Camera to body.
T_BS = np.eye(4)
T_BS[:3, :3] = Rotation.from_rotvec([0.1, 0.4, -1.2]).as_matrix()
T_BS[:3, 3] = 0.1, -0.2, 0.3
FOCAL, CENTER = (50, 52), (31.5, 23.5)
pytestmark = pytest.mark.filterwarnings("ignore:.*times are counted from the first one")


def sensor(matrix=T_BS, kind="radial-tangential", values=(0.1, -0.02, 0.003, 0.002)):
    data = ", ".join(f"{x:.17g}" for x in np.ravel(matrix))
    return (
        f"sensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n  data: [{data}]\n"
        f"resolution: [{W}, {H}]\ncamera_model: pinhole\n"
        f"intrinsics: [{FOCAL[0]}, {FOCAL[1]}, {CENTER[0]}, {CENTER[1]}]\n"
        f"distortion_model: {kind}\ndistortion_coefficients: {list(values)}\n"
    )


def lay(folder, text=None, table="state_groundtruth_estimate0"):
    for camera in ("cam0", "cam1"):
        for k in range(2):
            write_picture(folder / f"mav0/{camera}/data/{FIRST + k * STEP}.png")
        (folder / f"mav0/{camera}/sensor.yaml").write_text(text or sensor())
    rows = [(FIRST + k * STEP, *PLACE, *QUAT, *(0,) * 9) for k in range(2)]
    path = folder / f"mav0/{table}/data.csv"
    path.parent.mkdir()
    lines = [",".join(map(repr, map(float, row))) for row in rows]
    path.write_text("#timestamp, p_RS_R_x [m], ...\n" + "\r\n".join(lines) + "\n")
    return folder


def check_pixels(view, seen, body=T_BS):
    """The camera looks from the body as its matrix says."""
    world, own = seen_points(TURN @ body[:3, :3], PLACE + TURN @ body[:3, 3])
    # The middle of the first pixel is 0 in the file, and 0.5 here.
    expected = seen(own) * FOCAL + CENTER + 0.5
    np.testing.assert_allclose(pixels(view, world), expected, atol=PIXELS)


def test_pixels_and_times_are_those_of_both_cameras(tmp_path):
    assert format_of(lay(tmp_path)) == "euroc"
    capture = open_capture(tmp_path)
    names = [(view.camera_name, view.split) for view in capture.views]
    assert names == [("cam0", "train")] * 2 + [("cam1", "train")] * 2
    np.testing.assert_allclose([v.time for v in capture.views], [0, 0.05] * 2, atol=1e-6)
    check_pixels(capture.views[1], lambda own: distorted(own, k1=0.1, k2=-0.02, p1=0.003, p2=0.002))
    assert format_of(tmp_path / "mav0") == "euroc"
    assert len(open_capture(tmp_path / "mav0").views) == 4


def test_a_fisheye_is_read_and_the_tracked_frame_may_be_another_than_the_body(tmp_path):
    lay(tmp_path, sensor(kind="equidistant", values=(0.01, 0.02, 0.003, 0.004)), table="vicon0")
    tracked = np.eye(4)
    tracked[:3, 3] = 1, 2, 3
    (tmp_path / "mav0/vicon0/sensor.yaml").write_text(sensor(tracked))
    views = open_capture(tmp_path).views
    body = np.linalg.inv(tracked) @ T_BS
    check_pixels(views[0], lambda own: fisheye(own, 0.01, 0.02, 0.003, 0.004), body)


def test_pictures_far_from_any_pose_are_left_out(tmp_path):
    lay(tmp_path)
    write_picture(tmp_path / f"mav0/cam1/data/{FIRST + 100 * STEP}.png")
    with pytest.warns(
        CaptureWarning, match="1 of 5 pictures, first mav0/cam1/data/.* no valid pos"
    ):
        assert len(open_capture(tmp_path).views) == 4


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("cam0/sensor.yaml", "a: [", "sensor.yaml: must be YAML"),
        ("cam0/sensor.yaml", "5", "sensor.yaml: must hold the keys of a sensor"),
        ("cam0/sensor.yaml", "a: 5", "sensor.yaml: intrinsics must be"),
        ("cam0/sensor.yaml", sensor(T_BS * [2, 2, 2, 1]), "sensor.yaml: T_BS.data must be"),
        (
            "cam0/sensor.yaml",
            sensor().replace("pinhole", "omni"),
            "camera_model must be one of pin",
        ),
        ("cam0/sensor.yaml", sensor(kind="fov"), "distortion_model must be one of radial-tang"),
        ("cam0/sensor.yaml", sensor(values=(1,)), "distortion_coefficients must be a list of 4"),
        ("cam0/sensor.yaml", sensor().replace("[50", "[-50"), "intrinsics must be fx, fy, cx"),
        ("state_groundtruth_estimate0/data.csv", "1,2,3", "data.csv, line 1: it must be a time in"),
        ("state_groundtruth_estimate0/data.csv", "#", "data.csv: must hold lines, each a time"),
        ("state_groundtruth_estimate0/data.csv", "1,2,3,4,5,6,7,8", "at least one picture must ha"),
    ],
)
def test_what_contradicts_the_format_is_named(tmp_path, name, text, says):
    (lay(tmp_path) / "mav0" / name).write_text(text)
    with pytest.raises(CaptureError, match=says):
        open_capture(tmp_path)


def test_other_folders_are_none_of_it(tmp_path):
    (lay(tmp_path) / "mav0/state_groundtruth_estimate0/data.csv").unlink()
    says = "mav0/cam0/sensor.yaml is .* It needs the trajectory mav0/state_groundtruth_estimate0/d"
    with pytest.raises(CaptureError, match=f"known format: {says}"):
        open_capture(tmp_path)
    with pytest.raises(FileNotFoundError, match=says):
        read_euroc(tmp_path)
    for name in ("cam0", "cam1"):
        (tmp_path / f"mav0/{name}/sensor.yaml").unlink()
    with pytest.raises(
        CaptureError, match="files of one format, got none of them.* euroc needs mav0/"
    ):
        open_capture(tmp_path)
    with pytest.raises(FileNotFoundError, match="holds no mav0/state_groundtruth_estimate0/data"):
        read_euroc(tmp_path)


def test_pictures_in_another_folder_than_data_are_told(tmp_path):
    lay(tmp_path)
    for name in ("cam0", "cam1"):
        (tmp_path / f"mav0/{name}/data").rename(tmp_path / f"mav0/{name}/images")
    says = "mav0/cam0/sensor.yaml is a file .* It needs pictures in mav0/cam0/data/, named by nano"
    with pytest.raises(CaptureError, match=says):
        open_capture(tmp_path)
    for name in ("cam0", "cam1"):
        (tmp_path / f"mav0/{name}/sensor.yaml").unlink()
    with pytest.raises(CaptureError, match="estimate0/data.csv is .* pictures in mav0/cam0/data/"):
        open_capture(tmp_path / "mav0" / "..")


def test_a_trajectory_is_found_beside_an_empty_folder_of_another(tmp_path):
    lay(tmp_path, table="vicon0")
    (tmp_path / "mav0/state_groundtruth_estimate0").mkdir()
    for name in ("cam0", "cam1"):
        (tmp_path / f"mav0/{name}/data").rename(tmp_path / f"mav0/{name}/images")
    assert euroc_near_miss(tmp_path) == (
        "mav0/cam0/sensor.yaml is a file of EuRoC's. It needs pictures in mav0/cam0/data/, named "
        "by nanoseconds."
    )


def test_stamps_of_a_clock_since_boot_are_nanoseconds_too(tmp_path):
    lay(tmp_path)
    first = 7_000_000_000
    for camera in ("cam0", "cam1"):
        for k in range(2):
            data = tmp_path / f"mav0/{camera}/data"
            (data / f"{FIRST + k * STEP}.png").rename(data / f"{first + k * STEP}.png")
    rows = [(first + k * STEP, *PLACE, *QUAT) for k in range(2)]
    table = tmp_path / "mav0/state_groundtruth_estimate0/data.csv"
    table.write_text("\n".join(",".join(map(repr, map(float, row))) for row in rows))
    times = [view.time for view in open_capture(tmp_path).views]
    np.testing.assert_allclose(times, [7, 7.05] * 2)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (sensor().replace("intrinsics: [50", "intrinsics: [1" + 400 * "0"), "4 finite numbers"),
        ("#" * 1_000_001, "must be at most 1,000,000 bytes"),
    ],
)
def test_a_sensor_of_any_size_and_numbers_ends_in_a_message(tmp_path, text, message):
    with pytest.raises(CaptureError, match=message):
        read_euroc(lay(tmp_path, text))


def test_a_missing_sensor_file_is_named(tmp_path):
    (lay(tmp_path) / "mav0/cam1/sensor.yaml").unlink()
    with pytest.raises(CaptureError, match=r"cam1/sensor.yaml: is missing. It holds"):
        read_euroc(tmp_path)


def test_two_pictures_of_one_time_are_refused(tmp_path):
    lay(tmp_path)
    picture = tmp_path / f"mav0/cam1/data/{FIRST}.png"
    picture.with_suffix(".jpg").write_bytes(picture.read_bytes())
    with pytest.raises(CaptureError, match="a time of its own"):
        read_euroc(tmp_path)
