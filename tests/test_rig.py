"""Every option of the rig exchanges what it names and nothing else."""

import json

import numpy as np
import pytest
import toy

from gaussray import rig
from gaussray.camera.lens import FisheyePolynomial, KannalaBrandt, Pinhole
from gaussray.capture.calibration import read_views
from gaussray.dataset.images import write_image
from gaussray.dataset.manifest import write_manifest


@pytest.fixture(scope="module")
def views(tmp_path_factory):
    path = tmp_path_factory.mktemp("rig") / "transforms.json"
    write_manifest(path, toy.records())
    return read_views(path)


def built(views, **groups):
    return rig.rig(views, options=rig.RigOptions(**groups), samples=3)


def test_keep_keeps_the_held_out_cameras(views):
    records = built(views)
    assert [r.camera_name for r in records] == ["cam_3"] * 3
    assert {(r.effect, r.samples, r.split) for r in records} == {("pinhole", 3, "test")}
    for record, view in zip(records, views[-3:], strict=True):
        assert record.camera.lens is view.camera.lens
        assert record.camera.shutter is view.camera.shutter
        assert record.camera.time == view.camera.time


def test_names_and_times_choose(views):
    camera = rig.CameraOptions(names=("cam_0", "cam_1"), times=(0.5,))
    assert [r.camera_name for r in built(views, camera=camera)] == ["cam_0", "cam_1"]


def test_every_lens_is_what_it_says(views):
    k = (0.0, -0.0745, -1.5e-4, -2.5e-5, 2e-7)
    flat = built(views, lens=rig.LensOptions("pinhole", 90.0))[0]
    assert isinstance(flat.camera.lens, Pinhole) and flat.effect == "pinhole"
    np.testing.assert_allclose(flat.camera.lens.focal, toy.SIZE / 2, rtol=1e-6)
    fish = built(views, lens=rig.LensOptions("fisheye_polynomial", 166.0, k))[0]
    assert isinstance(fish.camera.lens, FisheyePolynomial) and fish.effect == "fisheye"
    kannala = built(views, lens=rig.LensOptions("kannala_brandt", 150.0, (-0.02, 0.0, 0.0, 0.0)))[0]
    assert isinstance(kannala.camera.lens, KannalaBrandt)
    np.testing.assert_allclose(kannala.camera.lens.max_angle, np.deg2rad(75), rtol=1e-6)


def test_effects_compose_and_are_named(views):
    shutter = rig.ShutterOptions("rolling", 0.25, 0.1, "left_to_right")
    aperture = rig.ApertureOptions(0.09, 2.0, blades=6)
    record = built(views, shutter=shutter, aperture=aperture,
                   film=rig.FilmOptions("gaussian", 2.0))[0]  # fmt: skip
    assert record.effect == "depth_of_field_rolling_shutter_motion_blur"
    camera = record.camera
    np.testing.assert_allclose(camera.shutter.row_offset, -0.125)
    np.testing.assert_allclose(camera.shutter.row_step * (toy.SIZE - 1), 0.25, rtol=1e-6)
    assert camera.shutter.direction == "left_to_right" and camera.aperture.blades == 6
    assert camera.film.filter == "gaussian" and camera.film.filter_width == 2.0


def test_a_ride_passes_every_camera(views):
    options = rig.CameraOptions(names=("cam_0", "cam_1", "cam_2"))
    records = built(views, camera=options, trajectory=rig.TrajectoryOptions("between", 7))
    assert len(records) == 7 and len({r.file_path for r in records}) == 7
    times = [float(r.camera.time) for r in records]
    np.testing.assert_allclose(times, np.linspace(0, 1, 7), rtol=1e-6)
    assert records[0].camera.trajectory.time.shape == (3,)


def test_cameras_come_from_a_capture_or_from_beside_the_scene(tmp_path):
    write_manifest(tmp_path / "cameras.json", toy.records())
    assert len(rig.cameras_of(tmp_path, None)) == 12
    assert len(rig.cameras_of(tmp_path / "scene.npz", None)) == 12
    with pytest.raises(FileNotFoundError, match="cameras=DIR"):
        rig.cameras_of(tmp_path / "none" / "scene.npz", None)


def test_pictures_are_png_or_exr(views):
    records = rig.rig(views, options=rig.RigOptions(), samples=1, format="exr")
    assert all(record.file_path.endswith(".exr") for record in records)
    with pytest.raises(ValueError, match="format must be png .* or exr .*, got 'jpg'"):
        rig.rig(views, options=rig.RigOptions(), samples=1, format="jpg")


def test_cameras_of_a_capture_in_splits(tmp_path):
    pose = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]
    for split in ("train", "test"):
        write_image(tmp_path / split / "r_0.png", np.full((12, 16, 3), 0.5))
        frame = {"file_path": f"./{split}/r_0", "time": 0.5, "transform_matrix": pose}
        content = {"camera_angle_x": 0.8, "frames": [frame]}
        (tmp_path / f"transforms_{split}.json").write_text(json.dumps(content))
    views = rig.cameras_of(tmp_path / "none", tmp_path)
    assert [view.split for view in views] == ["train", "test"]
    assert (views[0].width, views[0].height, views[0].time) == (16, 12, 0.5)
