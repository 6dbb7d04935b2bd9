"""Velocities of Carla-RS, as its generator (github.com/ethliup/UnrealCV) defines them.

With the turn rate w and the velocity v of gt_vel.log, the camera stands at pose(0) [exp(w t), v t]
when a row is exposed; t is 0 at the first row of the first frame.
"""

import json

import numpy as np
import pytest
import toy
from scipy.spatial.transform import Rotation

from gaussray.camera.imu import ImuOptions
from gaussray.cli.main import main
from gaussray.dataset.images import write_image
from gaussray.dataset.layouts import write_layout
from gaussray.dataset.manifest import write_manifest
from gaussray.dataset.sample_manifest import read_frames
from gaussray.scene.store import save_scene


pytestmark = pytest.mark.usefixtures("known_sizes")

TURN_RATE, VELOCITY = np.array([0.4, -0.9, 0.3]), np.array([1.5, -0.2, 2.0])
FIRST = Rotation.from_rotvec([0.1, -0.7, 0.4])
# Axes right, up, back of a capture from right, down, forward.
AXES = np.array([1, -1, -1])


def generated(t):
    """Camera to world of the generator's motion, OpenGL axes."""
    pose = np.eye(4)
    pose[:3, :3] = (FIRST * Rotation.from_rotvec(TURN_RATE * t)).as_matrix() * AXES
    pose[:3, 3] = FIRST.apply(VELOCITY * t) + [1.0, 2.0, 3.0]
    return pose.tolist()


def path(times, pose=generated):
    return [{"time": t, "transform_matrix": pose(t)} for t in times]


def velocities(folder, block, row_times, **units):
    """gt_vel.log of a sample of two frames on a path, read as the loader does."""
    frames = []
    for i, rows in enumerate(row_times):
        name = f"takes/000000/a{i}.png"
        write_image(folder / name, np.zeros((3, 2, 3), np.uint8))
        labels = {"global_first": f"a{i}.png", "global_middle": f"a{i}.png"}
        frame = {"file_path": f"a{i}.png", "w": 2, "h": 3, "time": rows[1], "row_times": rows}
        frame |= {"labels": labels, "transform_matrix": generated(rows[1]), "trajectory": block}
        frames.append(frame)
    line = {"version": 1, "index": 0, "folder": "takes/000000", "frames": frames}
    (folder / "manifest.jsonl").write_text(json.dumps(line) + "\n")
    assert write_layout(folder, folder / "out", "carla_rs", imu=ImuOptions(**units)) == 2
    lines = (folder / "out/000000/gt_vel.log").read_text().splitlines()
    (values,) = [line.split(" ") for line in lines if "#" not in line]
    return np.array([float(x) for x in values])


ROWS = [[0.0, 0.05, 0.1], [0.2, 0.25, 0.3]]


@pytest.mark.parametrize("interpolation", ["linear", "spline"])
def test_the_generators_motion_has_the_generators_velocities(tmp_path, interpolation):
    """Turn rate and velocity are constant, also between uneven poses."""
    block = {"poses": path([-0.1, 0.0, 0.07, 0.3, 0.4]), "interpolation": interpolation}
    found = velocities(tmp_path, block, ROWS)
    np.testing.assert_allclose(found, [*TURN_RATE, *VELOCITY], atol=1e-7)


def test_metres_and_seconds_are_those_of_the_imu(tmp_path):
    block = {"poses": path([-0.1, 0.4])}
    found = velocities(tmp_path, block, ROWS, units_per_metre=4.0, seconds_per_unit=0.5)
    np.testing.assert_allclose(found, [*TURN_RATE / 0.5, *VELOCITY / 2], atol=1e-7)


def test_a_linear_path_with_a_corner_has_the_velocity_at_the_first_row(tmp_path):
    """It is twice as fast after 0.04, between the first row and the frame's time."""
    slow = path([-0.1, 0.04, 0.4], lambda t: generated(t if t < 0.05 else 0.04 + 2 * (t - 0.04)))
    found = velocities(tmp_path, {"poses": slow, "interpolation": "linear"}, ROWS)
    np.testing.assert_allclose(found, [*TURN_RATE, *VELOCITY], atol=1e-7)
    rows = [[0.05, 0.1, 0.15], [0.2, 0.25, 0.3]]
    found = velocities(tmp_path, {"poses": slow, "interpolation": "linear"}, rows)
    # The velocity's axes are the camera's at that row.
    angle = 0.04 + 2 * (0.05 - 0.04)
    turned = Rotation.from_rotvec(-TURN_RATE * angle).apply(VELOCITY)
    np.testing.assert_allclose(found, [*2 * TURN_RATE, *2 * turned], atol=1e-7)


def test_a_path_that_begins_after_the_first_row_has_the_velocity_of_its_beginning(tmp_path):
    block = {"poses": path([0.0, 0.4])}
    found = velocities(tmp_path, block, [[-0.05, 0.0, 0.05], [0.15, 0.2, 0.25]])
    np.testing.assert_allclose(found, [*TURN_RATE, *VELOCITY], atol=1e-7)


def test_velocities_of_a_rendered_sequence_are_differences_of_its_poses(tmp_path):
    """The loader's user moves the first frame by them to the times of all others."""
    scene, walk, out = tmp_path / "scene", tmp_path / "walk.json", tmp_path / "data"
    save_scene(scene / "scene.npz", toy.scene())
    write_manifest(scene / "cameras.json", toy.records())
    lens = {"camera_model": "PINHOLE", "fl_x": 16.0, "fl_y": 16.0, "cx": 8.0, "cy": 8.0}
    frames = [{"file_path": "a.png", **pose} for pose in path([0.0, 0.5, 1.0])]
    walk.write_text(json.dumps({**lens, "w": 16, "h": 16, "frames": frames}))
    main(
        [
            *("render", f"scene={scene}", f"out={out}", "dataset.count=1", "dataset.frames=0"),
            "dataset.clearance=0",
            *("trajectory=path", f"trajectory.file={walk}", "trajectory.steps=4"),
            *("lens=pinhole", "shutter.readout=0.2", "render.samples=1", "trace.levels=0"),
            *("trace.group=2", "trace.chunk=8", "trace.k=4", "quiet=true", "report=false"),
            *("camera.names=[cam_0]", "dataset.layout=carla_rs"),
        ]
    )
    log = (out / "carla_rs/000000/gt_vel.log").read_text().splitlines()
    motion = np.array([float(x) for x in log[-1].split(" ")])
    frames = list(read_frames(out))
    poses = [np.array(frame["transform_matrix"]) for frame in frames]
    assert len(poses) == 4
    for frame, pose in zip(frames[1:], poses[1:], strict=True):
        elapsed = frame["time"] - frames[0]["time"]
        moved = np.linalg.inv(poses[0]) @ pose
        turn = Rotation.from_matrix(moved[:3, :3]).as_rotvec() * AXES
        np.testing.assert_allclose(turn / elapsed, motion[:3], atol=1e-4)
        np.testing.assert_allclose(moved[:3, 3] * AXES / elapsed, motion[3:], atol=1e-4)
    np.testing.assert_allclose(motion[:3], TURN_RATE, atol=1e-4)
