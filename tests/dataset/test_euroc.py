"""Samples as EuRoC writes them, read as its users do."""

import json

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from gaussray.camera.imu import ImuOptions
from gaussray.dataset.images import write_image
from gaussray.dataset.layouts import write_layout


# Of a file with twelve digits.
DIGITS = 1e-9
LENS = {"camera_model": "OPENCV", "fl_x": 8.0, "fl_y": 8.0, "cx": 3.5, "cy": 2.5, "k1": 0.25}
TURN = Rotation.from_rotvec([0.1, -0.7, 0.4])


def matrix(place):
    """Camera to world in OpenGL axes."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = TURN.as_matrix() * [1, -1, -1], place
    return pose.tolist()


def written(folder, places, times, **more):
    frames = []
    for i, (place, time) in enumerate(zip(places, times, strict=True)):
        write_image(folder / f"takes/000002/a{i}.png", np.full((5, 7, 3), 9 * i, np.uint8))
        frame = {"file_path": f"a{i}.png", "w": 7, "h": 5, "time": time, **LENS, **more}
        frames.append(frame | {"transform_matrix": matrix(place)})
    line = {"version": 1, "index": 2, "folder": "takes/000002", "frames": frames}
    (folder / "manifest.jsonl").write_text(json.dumps(line) + "\n")
    return folder


def table(path):
    """Numbers of a EuRoC csv; nanoseconds as whole numbers."""
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    cells = [line.split(",") for line in lines]
    return [int(row[0]) for row in cells], [row[1:] for row in cells]


def numbers(path):
    times, cells = table(path)
    return times, np.array(cells, float)


def test_a_camera_at_rest_has_pictures_imu_and_state(tmp_path):
    data = written(tmp_path, [(1, 2, 3)] * 3, [0.0, 0.5, 1.0])
    assert write_layout(data, tmp_path / "out", "euroc", imu=ImuOptions(rate=20.0)) == 3
    root = tmp_path / "out/000002/mav0"
    times, names = table(root / "cam0/data.csv")
    assert times == [0, 500_000_000, 1_000_000_000]
    assert all((root / "cam0/data" / name[0]).is_file() for name in names)
    times, imu = numbers(root / "imu0/data.csv")
    assert times == [k * 50_000_000 for k in range(21)]
    np.testing.assert_allclose(imu[:, :3], 0, atol=DIGITS)
    up = TURN.inv().apply([0, 0, 9.81])
    np.testing.assert_allclose(imu[:, 3:], np.tile(up, (21, 1)), atol=DIGITS)
    stamps, state = numbers(root / "state_groundtruth_estimate0/data.csv")
    assert stamps == times and state.shape == (21, 16)
    np.testing.assert_allclose(state[:, :3], [[1, 2, 3]] * 21, atol=DIGITS)
    quat = Rotation.from_quat(state[:, [4, 5, 6, 3]])
    assert (quat * TURN.inv()).magnitude().max() < 1e-7
    np.testing.assert_allclose(state[:, 7:], 0, atol=DIGITS)
    camera = yaml.safe_load((root / "cam0/sensor.yaml").read_text())
    assert camera["intrinsics"] == [8.0, 8.0, 3.0, 2.0] and camera["resolution"] == [7, 5]
    assert camera["distortion_coefficients"] == [0.25, 0, 0, 0] and camera["rate_hz"] == 2.0
    assert yaml.safe_load((root / "imu0/sensor.yaml").read_text())["rate_hz"] == 20.0


def test_a_path_of_the_manifest_is_felt_and_negative_times_are_moved(tmp_path):
    """p = 3 t^2 / 2 along x, which a spline keeps; rows are seen from -0.25 s on."""
    times = [-0.2, 0.0, 0.4, 1.0]
    poses = [{"time": t, "transform_matrix": matrix((1.5 * t * t, 0, 0))} for t in times]
    block = {"poses": poses, "interpolation": "spline"}
    data = written(
        tmp_path, [(0, 0, 0), (0.24, 0, 0)], [0.0, 0.4], trajectory=block, row_times=[-0.25, 0.25]
    )
    options = ImuOptions(gravity=(0.0, 0.0, 0.0), rate=50.0)
    write_layout(data, tmp_path / "out", "euroc", imu=options)
    root = tmp_path / "out/000002/mav0"
    stamps, imu = numbers(root / "imu0/data.csv")
    # From the first pose at -0.2 s, a second later, to the last picture at 0.4 s.
    assert stamps[0] == 800_000_000 and stamps[-1] == 1_400_000_000
    assert table(root / "cam0/data.csv")[0] == [1_000_000_000, 1_400_000_000]
    push = TURN.inv().apply([3.0, 0, 0])
    np.testing.assert_allclose(imu[:, 3:], np.tile(push, (len(imu), 1)), atol=1e-6)


def test_frames_with_poses_of_their_own_are_joined_by_a_spline(tmp_path):
    times = [0.0, 0.25, 0.5, 1.0]
    data = written(tmp_path, [(1.5 * t * t, 0, 0) for t in times], times)
    write_layout(data, tmp_path / "out", "euroc", imu=ImuOptions(gravity=(0.0, 0.0, 0.0)))
    _, imu = numbers(tmp_path / "out/000002/mav0/imu0/data.csv")
    push = TURN.inv().apply([3.0, 0, 0])
    np.testing.assert_allclose(imu[:, 3:], np.tile(push, (len(imu), 1)), atol=1e-6)


@pytest.mark.parametrize("name", ["k3", "s1", "tau_x"])
def test_a_lens_that_euroc_does_not_know_is_refused(tmp_path, name):
    data = written(tmp_path, [(0, 0, 0)], [0.0], **{name: 0.1})
    with pytest.raises(ValueError, match=f"sample 000002: .*got OPENCV with {name}.*lens=pinhole"):
        write_layout(data, tmp_path / "out", "euroc")
