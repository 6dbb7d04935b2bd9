"""Which camera of a calibration each video, folder or picture of the input is given."""

import dataclasses
import pathlib

import numpy as np
import pytest
from quads import arc
from scipy.spatial.transform import Rotation

from gaussray.prepare.calibrations.assign import assign_cameras, stills_by_camera
from gaussray.prepare.calibrations.known_camera import Calibration, KnownCamera, opencv_camera
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.sources import Source


WIDTH, HEIGHT = 640, 480
MATRIX = np.array([[500.0, 0, 310.25], [0, 505.0, 242.5], [0, 0, 1]])
POSES = arc(3)
NAMES = ("cam01", "cam02", "cam03")
CLOSE = 1e-9


def rig(*names):
    """Three calibrated cameras."""
    return Calibration(
        [
            opencv_camera("rig", name, MATRIX, np.zeros(4), pose, (WIDTH, HEIGHT))
            for name, pose in zip(names or NAMES, POSES, strict=True)
        ]
    )


def source(name, width=WIDTH, height=HEIGHT):
    return Source(name, pathlib.Path(f"{name}.mp4"), (), np.zeros(3), ((width, height),))


def test_cameras_are_given_by_name_or_by_number():
    known = rig()
    given, remarks, _ = assign_cameras(known, [source("Cam02"), source("view_1")])
    assert given["Cam02"].pose == pytest.approx(POSES[1], abs=CLOSE)
    assert given["view_1"].pose == pytest.approx(POSES[0], abs=CLOSE) and not remarks
    with pytest.raises(PrepareError, match="got no left among cam01, cam02, cam03"):
        assign_cameras(known, [source("left")])


def test_a_camera_may_be_a_part_of_the_name_of_its_video():
    known = rig("back", "top", "side")
    given, _, _ = assign_cameras(known, [source("minimal_Top"), source("minimal-back")])
    assert given["minimal_Top"].pose == pytest.approx(POSES[1], abs=CLOSE)
    with pytest.raises(PrepareError, match="got no stop"):
        assign_cameras(known, [source("stop")])


def test_another_size_is_scaled_and_another_shape_refused():
    known = rig()
    given, remarks, _ = assign_cameras(known, [source("cam01", 320, 240)])
    assert given["cam01"].lens["fl_x"] == pytest.approx(250) and "it is scaled" in remarks[0].text
    given, remarks, _ = assign_cameras(known, [source("cam01", 640, 488)])
    assert given["cam01"].lens["fl_y"] == pytest.approx(505) and "as it is" in remarks[0].text
    with pytest.raises(PrepareError, match="of the same shape"):
        assign_cameras(known, [source("cam01", 480, 640)])


def test_two_cameras_of_one_pose_are_refused():
    cameras = rig().cameras
    copied = KnownCamera("cam03", cameras[2].lens, cameras[1].pose)
    calibration = Calibration([*cameras[:2], copied])
    with pytest.raises(PrepareError, match=r"for cam02 and cam03, .* Calibrate the poses"):
        assign_cameras(calibration, [source(name) for name in NAMES])
    # Two photographs may be from one place, unless nobody has calibrated it, or all are from it.
    photographs = stills_by_camera(calibration, stills(*NAMES))
    _, findings, _ = assign_cameras(calibration, photographs)
    (text,) = (one.text for one in findings if one.subject == "cameras")
    assert text.startswith("cam02 and cam03 have the same pose") and "not matched" in text
    nowhere = [KnownCamera(c.name, c.lens, np.eye(3, 4)) for c in cameras[1:]]
    alike = [dataclasses.replace(camera, pose=cameras[0].pose) for camera in cameras]
    for given in ([cameras[0], *nowhere], alike):
        with pytest.raises(PrepareError, match="as if they had not been calibrated"):
            assign_cameras(Calibration(given), photographs)
    # Neither the same place alone nor the same rotation alone is a copy.
    turned, moved = cameras[1].pose.copy(), cameras[1].pose.copy()
    turn = Rotation.from_rotvec([0, 1e-3, 0]).as_matrix()
    turned, moved[:, 3] = turn @ turned, moved[:, 3] + [0.001, 0, 0]
    for pose in (turned, moved):
        calibration = Calibration([*cameras[:2], KnownCamera("cam03", cameras[2].lens, pose)])
        given, _, _ = assign_cameras(calibration, [source(name) for name in NAMES])
        assert list(given) == list(NAMES)


def test_two_videos_of_one_camera_are_refused():
    known = rig()
    with pytest.raises(PrepareError, match="got cam01 for both view_1 and cam_1"):
        assign_cameras(known, [source("view_1"), source("cam_1")])


def stills(*names):
    """Pictures of one folder."""
    paths = tuple(pathlib.Path("rig") / f"{name}.jpg" for name in names)
    sizes = ((WIDTH, HEIGHT),) * len(names)
    return [Source("rig", pathlib.Path("rig"), paths, np.zeros(0), sizes)]


def test_a_picture_of_each_camera_in_one_folder_is_that_camera(capsys):
    known = rig()
    found = stills_by_camera(known, stills(*NAMES))
    assert [(one.name, one.count) for one in found] == [(name, 1) for name in NAMES]
    assert [one.pictures[0].name for one in found] == [f"{name}.jpg" for name in NAMES]
    given, _, _ = assign_cameras(known, found)
    assert list(given) == list(NAMES)
    assert "each of the 3 pictures is of the camera of its name." in capsys.readouterr().out
    # The camera may be a part of the name; one without a pose is told of by `assign_cameras`.
    found = stills_by_camera(known, stills("cam_1_img_0", "cam_2_img_0"))
    assert [one.name for one in found] == ["cam_1", "cam_2"]


@pytest.mark.parametrize("names", [("cam01",), ("cam01", "view_1"), ("a_1", "b_9")])
def test_other_pictures_of_one_folder_stay_together(names):
    known, sources = rig(), stills(*names)
    assert stills_by_camera(known, sources) == sources
    with pytest.raises(PrepareError, match="put each picture into a folder of its own name"):
        assign_cameras(known, sources)
    both = [source("cam01"), source("left")]
    assert stills_by_camera(known, both) == both
    with pytest.raises(PrepareError, match="Rename the video or folder, or take it away"):
        assign_cameras(known, both)
