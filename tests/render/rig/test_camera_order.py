"""Frames, delays and rides follow the order of camera.names; the pictures keep their numbers."""

import dataclasses

import numpy as np
import pytest
import toy

from gaussray.render.rig import rig
from gaussray.render.rig.placed import placed_views
from gaussray.render.rig.trajectory import move_cameras


def records(views, *names, **groups):
    options = rig.RigOptions(camera=rig.CameraOptions(names=names), **groups)
    return rig.frame_records(views, options=options, samples=1)


def test_pictures_keep_their_numbers_in_any_order_of_names(views):
    forth = records(views, "cam_1", "cam_3")
    back = records(views, "cam_3", "cam_1")
    assert [one.camera_name for one in back] == ["cam_3"] * 3 + ["cam_1"] * 3
    times = {one.file_path: float(one.camera.time) for one in back}
    assert times == {one.file_path: float(one.camera.time) for one in forth}
    assert [one.file_path for one in forth] == sorted(times)
    assert back[0].file_path == "images/pinhole/cam_3/0003.png"


def test_delays_and_shakes_are_those_of_the_named_order(views):
    found = records(
        views, "cam_3", "cam_1", shutter=rig.ShutterOptions(trigger=(0.1, 0.2)),
        trajectory=rig.TrajectoryOptions(shake_degrees=1.0, shake_seed=4),
    )  # fmt: skip
    for one in found:
        delay, seed = {"cam_3": (0.1, 4), "cam_1": (0.2, 5)}[one.camera_name]
        np.testing.assert_allclose(one.camera.shutter.trigger, delay, rtol=1e-6)
        assert float(one.camera.trajectory.shake.seed) == seed


def places(views, *names):
    ride = records(views, *names, trajectory=rig.TrajectoryOptions("between", steps=4))
    assert [one.file_path[-8:] for one in ride] == [f"{i:04d}.png" for i in range(4)]
    return np.asarray(ride[0].camera.trajectory.translation)


def test_a_ride_passes_the_cameras_in_their_order_and_may_return(views):
    place = {v.camera_name: np.asarray(v.camera.trajectory.translation[0]) for v in views}
    for names in (("cam_3", "cam_1"), ("cam_1", "cam_3"), ("cam_2", "cam_0", "cam_2")):
        np.testing.assert_array_equal(places(views, *names), [place[name] for name in names])
    with pytest.raises(ValueError, match="between needs at least two cameras"):
        places(views, "cam_2", "cam_2")


def test_the_camera_of_a_ride_is_the_first_in_its_order_whatever_that_of_the_frames(views):
    starts = {view.camera_name: toy.single(k + 0.5) for k, view in enumerate(views)}
    frames = [
        (
            view.camera_name,
            view.split,
            dataclasses.replace(view.camera, clip_start=starts[view.camera_name]),
        )
        for view in views
    ]
    options = rig.TrajectoryOptions("between", steps=2)
    for first in ("cam_0", "cam_2"):
        ride = move_cameras(frames, options, (first, "cam_1"))
        assert all(camera.clip_start == starts[first] for _, _, camera in ride)


@pytest.mark.parametrize("kind", ["keep", "path"])
def test_a_camera_that_is_named_twice_is_refused_but_on_a_ride_between(views, kind):
    options = rig.TrajectoryOptions(kind, file="a.txt" if kind == "path" else "")
    with pytest.raises(ValueError, match="must name each camera once, got cam_1 more than once"):
        records(views, "cam_1", "cam_3", "cam_1", trajectory=options)


def test_a_file_of_poses_that_is_missing_is_named_with_its_key(views):
    options = rig.TrajectoryOptions("path", file="/nope.json")
    with pytest.raises(FileNotFoundError, match=r"^trajectory\.file=/nope\.json: no such file"):
        records(views, "cam_1", trajectory=options)
    with pytest.raises(FileNotFoundError, match=r"^camera\.file=/nope\.json: no such file"):
        rig_path = rig.CameraOptions("path", file="/nope.json")
        placed_views(toy.scene(), rig_path)
