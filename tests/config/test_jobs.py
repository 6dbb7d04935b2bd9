"""What a render job says about the choices that nobody made."""

import dataclasses

import toy

from gaussray.config.compose import compose_config
from gaussray.config.jobs import render_job
from gaussray.dataset.manifest import FIT_SCALE, write_manifest
from gaussray.render.rig.view_files import load_views
from gaussray.scene.store import save_scene


def notes(folder, split, *overrides, about="held out", times=toy.TIMES, scale=1.0):
    """The lines that a job gives about the cameras of a run with this split in place of others."""
    save_scene(folder / "scene.npz", toy.scene())
    listed = toy.records(times)
    if split:
        listed = [dataclasses.replace(record, split=split) for record in listed]
    write_manifest(folder / "cameras.json", listed, extra={"info": {FIT_SCALE: scale}})
    said = []
    cfg = compose_config("render", [f"scene={folder}", f"out={folder}/out", *overrides])
    render_job(cfg, lambda _: toy.scene(), load_views, said.append)
    return [line for line in said if about in line]


def test_a_capture_that_holds_out_no_camera_says_which_are_rendered(tmp_path):
    first, last = toy.CAMERAS[0], toy.CAMERAS[-1]
    (line,) = notes(tmp_path, "train")
    assert line.startswith(
        f"No camera is held out, so all {len(toy.CAMERAS)} are rendered ({first}"
    )
    assert last in line and "camera.names=" in line


def test_chosen_or_held_out_cameras_need_no_word(tmp_path):
    assert not notes(tmp_path, None)
    assert not notes(tmp_path, "train", f"camera.names=[{toy.CAMERAS[0]}]")
    assert not notes(tmp_path, "train", "camera.split=train")
    assert not notes(tmp_path, "train", "camera=orbit")


def test_pictures_as_small_as_the_fit_saw_them_are_told(tmp_path):
    about = "as the fit saw them"
    (line,) = notes(tmp_path, None, about=about, scale=0.5)
    assert line.startswith("Pictures are 8 x 8, as the fit saw them (0.5 of the capture's sides);")
    assert not notes(tmp_path, None, "film.size=[12,12]", about=about, scale=0.5)
    assert not notes(tmp_path, None, "camera=orbit", about=about, scale=0.5)
    assert not notes(tmp_path, None, about=about)


def test_pictures_far_outside_of_the_scenes_times_are_told(tmp_path):
    about = "exposed far outside"
    assert not notes(tmp_path, None, "shutter.readout=0.05", about=about)
    (line,) = notes(tmp_path, None, "shutter.readout=20", about=about)
    assert "of the scene's times, 0 to 1" in line and "physical.*" in line
    (line,) = notes(tmp_path, None, "shutter.trigger=[100]", about=about)
    assert line.startswith("3 of 3 ")


def test_where_flow_of_an_only_frame_leads_is_told_for_each_case(tmp_path):
    asked = "labels=[flow_forward,flow_backward]"
    middle, end = "camera.times=[0.5]", "camera.times=[1.0]"
    forth, back = notes(tmp_path, None, asked, middle, about="flow_")
    assert forth.startswith("flow_forward of the only frame of cam_3 leads to the capture's next ")
    assert back.endswith("previous frame of that camera, 0.5 in time away.")
    forth, back = notes(tmp_path, None, asked, end, about="flow_")
    assert forth.startswith("flow_forward of the only frame of cam_3 is NaN: the capture has no ")
    assert back.startswith("flow_backward of the only frame of cam_3 leads")
    ride = ("trajectory=between", "trajectory.steps=1", "camera.split=train", middle)
    forth, _ = notes(tmp_path, None, asked, *ride, about="flow_")
    assert "of ride leads" in forth and forth.endswith("of its first camera, 0.5 in time away.")
    (line,) = notes(tmp_path, None, asked, about="flow_", times=(0.2,))
    assert line.startswith("labels: without flow_forward, flow_backward, because there is one time")
    # Every frame has another one of its camera, or none is asked for.
    assert not notes(tmp_path, None, asked, about="flow_")
    assert not notes(tmp_path, None, middle, about="flow_")
