"""What a render job says about the trajectory: lenses, fields of view, clocks and shakes."""

import dataclasses
import json

import equinox as eqx
import numpy as np
import pytest
import toy

from gaussray.camera.lens import KannalaBrandt
from gaussray.config.compose import compose_config
from gaussray.config.jobs import render_job
from gaussray.dataset.manifest import write_manifest
from gaussray.render.rig.view_files import load_views


BETWEEN = ("trajectory=between", "trajectory.steps=3")


def told(folder, *overrides, lenses=None, split="train"):
    """The records of a job and the lines that it gives, with lenses that `lenses` changes."""
    changed = [
        dataclasses.replace(
            record, split=split, camera=(lenses or (lambda name, camera: camera))(name, camera)
        )
        for record in toy.records()
        for name, camera in [(record.camera_name, record.camera)]
    ]
    write_manifest(folder / "cameras.json", changed)
    said = []
    cameras = f"cameras={folder / 'cameras.json'}"
    cfg = compose_config("render", [f"scene={folder}", f"out={folder}/out", cameras, *overrides])
    job = render_job(cfg, lambda _: toy.scene(), load_views, said.append)
    return job.records, said


def longer(by):
    """Lenses whose focal lengths are longer by a factor for each camera's name."""
    return lambda name, camera: eqx.tree_at(
        lambda c: c.lens.focal, camera, camera.lens.focal * by.get(name, 1.0)
    )


def about(lines, words):
    return [line for line in lines if words in line]


def test_a_ride_has_the_lens_of_its_first_camera_and_says_so_where_others_differ(tmp_path):
    lenses = longer({"cam_0": 3.0, "cam_1": 2.0})
    own = float(toy.records()[0].camera.lens.focal[0])
    names = "camera.names=[cam_1,cam_0,cam_2]"
    records, lines = told(tmp_path, *BETWEEN, names, lenses=lenses)
    (line,) = about(lines, "lens of")
    assert line.startswith(
        f"All pictures of the ride have the lens of cam_1, a focal length of {2 * own:.0f} pixels; "
        f"the others have {own:.0f} to {3 * own:.0f} pixels at that size."
    )
    np.testing.assert_allclose([r.camera.lens.focal[0] for r in records], 2 * own, rtol=1e-6)
    # Focal lengths are those on pictures of the rendered size.
    _, lines = told(tmp_path, *BETWEEN, names, "film.size=[64,64]", lenses=lenses)
    scale = 64 / toy.SIZE
    (line,) = about(lines, f"{scale * own:.0f} to {3 * scale * own:.0f} pixels at that size")


def test_lenses_that_are_alike_or_chosen_need_no_word(tmp_path):
    assert not about(told(tmp_path, *BETWEEN)[1], "lens of")
    assert not about(told(tmp_path, *BETWEEN, lenses=longer({"cam_2": 1.02}))[1], "lens of")
    other = longer({"cam_2": 2.0})
    assert not about(told(tmp_path, *BETWEEN, "lens=pinhole", lenses=other)[1], "lens of")
    assert not about(told(tmp_path, lenses=other)[1], "lens of")


def test_a_ride_between_lenses_of_several_kinds_says_so(tmp_path):
    def lenses(name, camera):
        if name != "cam_2":
            return camera
        fisheye = KannalaBrandt(
            camera.lens.focal, camera.lens.center, toy.single([0.0] * 4), toy.single(1.2)
        )
        return dataclasses.replace(camera, lens=fisheye)

    (line,) = about(told(tmp_path, *BETWEEN, lenses=lenses)[1], "lens of cam_0")
    assert "; others have other kinds of lenses. camera.names=" in line


def test_cameras_of_a_ride_are_passed_and_those_of_a_path_do_not_matter(tmp_path):
    (line,) = about(told(tmp_path, *BETWEEN)[1], "held out")
    assert line.startswith("No camera is held out, so the ride passes all 4 (cam_0 to cam_3); ")
    file = tmp_path / "path.txt"
    file.write_text("0 0 0 -3 0 0 0 1\n1 1 0 -3 0 0 0 1\n")
    assert not told(tmp_path, "trajectory=path", f"trajectory.file={file}")[1]


@pytest.mark.parametrize("key", ["camera", "trajectory"])
def test_a_field_of_view_in_a_path_file_is_told_with_the_key_that_sets_it(tmp_path, key):
    poses = [{"camera_to_world": np.eye(4).ravel().tolist(), "fov": fov} for fov in (40, 65)]
    file = tmp_path / "path.json"
    file.write_text(json.dumps({"camera_path": poses, "render_width": 4, "render_height": 3}))
    path = f"{key}=path", f"{key}.file={file}"
    (line,) = about(told(tmp_path, *path)[1], "fov")
    assert line.startswith(
        f"{key}.file={file}: its poses alone are read, not its fov (40 to 65 degrees from top to "
        "bottom); lens=pinhole lens.fov=51.77 gives all pictures the first pose's field of view"
    )
    assert not about(told(tmp_path, *path, "lens=pinhole", "lens.fov=60")[1], "poses alone")
    file.write_text(json.dumps({"camera_path": [{"camera_to_world": np.eye(4).tolist()}] * 2}))
    assert not about(told(tmp_path, *path)[1], "poses alone")


def test_a_clock_that_is_not_the_scenes_is_told_with_both_ranges(tmp_path):
    file = tmp_path / "path.txt"
    path = "trajectory=path", f"trajectory.file={file}", "trajectory.clock=file"
    file.write_text("100 0 0 -3 0 0 0 1\n102 1 0 -3 0 0 0 1\n")
    (line,) = about(told(tmp_path, *path)[1], "clock")
    assert "100 to 102, lie outside of the scene's, 0 to 1." in line and "clock=span" in line
    file.write_text("0.5 0 0 -3 0 0 0 1\n2 1 0 -3 0 0 0 1\n")
    assert not about(told(tmp_path, *path)[1], "clock")


def test_cameras_of_one_time_that_shake_say_that_each_does_so_by_itself(tmp_path):
    shake = "trajectory.shake_degrees=0.5", "trajectory.shake_seed=7"
    (line,) = about(told(tmp_path, *shake)[1], "shakes by itself")
    assert "(seeds 7 to 10)" in line
    assert not about(told(tmp_path)[1], "shakes")
    assert not about(told(tmp_path, *shake, "camera.names=[cam_1]")[1], "shakes")
    assert not about(told(tmp_path, *shake, *BETWEEN)[1], "shakes")
