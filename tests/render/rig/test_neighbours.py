"""The only frame of a camera has the capture's own frames before and after it as neighbours."""

import dataclasses

import numpy as np
import pytest
import toy

from gaussray.capture.formats.paired import read_views
from gaussray.dataset.manifest import write_manifest
from gaussray.render.aov.files import neighbour_cameras
from gaussray.render.rig import rig
from gaussray.render.rig.neighbours import views_beside


SCENE = (0.0, 1.0)


@pytest.fixture(scope="module")
def views(tmp_path_factory):
    """Two cameras with three frames each; the second moves, and has one more time in between."""
    path = tmp_path_factory.mktemp("near") / "transforms.json"
    moving = [
        dataclasses.replace(one, camera=toy.camera(0.1 * i, float(one.camera.time)))
        for i, one in enumerate(toy.records((0.0, 0.25, 0.5, 1.0), ("cam_1",)))
    ]
    write_manifest(path, [*toy.records(cameras=("cam_0",)), *moving])
    return read_views(path)


def near(views, times=(0.5,), within=SCENE, names=("cam_0", "cam_1"), **groups):
    """The neighbours of the records, by camera name."""
    options = rig.RigOptions(camera=rig.CameraOptions(names=names, times=times), **groups)
    records = rig.frame_records(views, options=options, samples=1, within=within)
    return {record.camera_name: record.neighbours for record in records}


def times_of(pair):
    return tuple(None if one is None else float(one.time) for one in pair)


def test_neighbours_are_the_cameras_own_whatever_other_cameras_there_are(views):
    found = near(views)
    assert times_of(found["cam_0"]) == (0.0, 1.0)
    assert times_of(found["cam_1"]) == (0.25, 1.0)


def test_a_camera_that_moves_has_the_poses_of_its_neighbours(views):
    before, after = near(views)["cam_1"]
    own = [view.camera.trajectory for view in views if view.camera_name == "cam_1"]
    for camera, path in ((before, own[1]), (after, own[3])):
        np.testing.assert_array_equal(camera.trajectory.translation, path.translation)


def test_there_is_none_beyond_the_capture_or_the_scene(views):
    assert times_of(near(views, (1.0,))["cam_0"]) == (0.5, None)
    assert times_of(near(views, (0.0,))["cam_0"]) == (None, 0.5)
    assert times_of(near(views, within=(0.2, 0.6))["cam_1"]) == (0.25, None)
    assert near(views, within=None) == {"cam_0": None, "cam_1": None}
    assert views_beside(views, "cam_9", 0.5) == (None, None)


def test_frames_of_a_sequence_have_each_other(views):
    found = near(views, (0.0, 0.5))
    assert found == {"cam_0": None, "cam_1": None}


def test_neighbours_have_what_the_options_change(views):
    groups = {
        "shutter": rig.ShutterOptions("rolling", 0.25, trigger=(0.01, 0.02)),
        "lens": rig.LensOptions("pinhole", 60.0),
        "trajectory": rig.TrajectoryOptions(shake_degrees=1.0, shake_seed=5),
    }
    for k, pair in enumerate(near(views, **groups).values()):
        for camera in pair:
            np.testing.assert_allclose(camera.shutter.trigger, 0.01 * (k + 1), rtol=1e-6)
            np.testing.assert_allclose(camera.shutter.row_offset, -0.125)
            assert float(camera.trajectory.shake.seed) == 5 + k
            assert float(camera.lens.focal[0]) == pytest.approx(8 / np.tan(np.pi / 6), rel=1e-6)


def test_the_only_frame_of_a_ride_has_the_ride_at_the_times_of_its_first_camera(views):
    ride = rig.TrajectoryOptions("between", steps=1)
    found = near(views, (0.5,), trajectory=ride, names=("cam_1", "cam_0"))
    assert times_of(found["ride"]) == (0.25, 1.0)
    assert near(views, (), trajectory=rig.TrajectoryOptions("between", steps=2)) == {"ride": None}


def test_flow_takes_the_neighbours_that_a_record_names():
    first, lone, last = toy.records()[:3]
    named = dataclasses.replace(lone, neighbours=(None, last.camera))
    assert neighbour_cameras([named])[lone.file_path] == (None, last.camera)
    both = neighbour_cameras([first, named])
    assert both[lone.file_path] == (first.camera, None)
