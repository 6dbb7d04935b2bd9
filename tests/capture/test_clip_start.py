"""Which cameras begin to see outside of their own bodies."""

import dataclasses
import json

import numpy as np
import pytest
import toy

from gaussray.capture.errors import CaptureError
from gaussray.capture.open import open_capture
from gaussray.capture.selection import Selection
from gaussray.dataset.images import write_image
from gaussray.dataset.manifest import write_manifest


TIMES = (0.0, 1.0)


def written(folder, records):
    """A capture of black pictures."""
    for record in records:
        write_image(folder / record.file_path, np.zeros((toy.SIZE, toy.SIZE, 3), np.float32))
    write_manifest(folder / "transforms.json", records, extra={"time_unit": "normalised"})
    return folder


def starts(folder, **selection):
    capture = open_capture(folder, selection=Selection(**selection))
    return {view.camera_name: view.camera.clip_start for view in capture.views}


def test_still_cameras_see_from_a_tenth_of_the_distance_to_the_next(tmp_path):
    records = toy.records(TIMES)
    found = starts(written(tmp_path, records))
    place = {r.camera_name: np.asarray(r.camera.trajectory.translation[0]) for r in records}
    for name, start in found.items():
        nearest = min(np.linalg.norm(place[name] - p) for n, p in place.items() if n != name)
        np.testing.assert_allclose(start, nearest / 10, rtol=1e-5)


def test_pictures_of_one_time_may_have_been_taken_in_turn(tmp_path):
    assert set(starts(written(tmp_path, toy.records((0.0,)))).values()) == {None}


def test_a_camera_that_moves_has_no_body_in_the_scene(tmp_path):
    records = toy.records(TIMES)
    moved = [
        dataclasses.replace(r, camera=toy.camera(0.1 * i)) if r.camera_name == "cam_0" else r
        for i, r in enumerate(records)
    ]
    found = starts(written(tmp_path, moved))
    assert found["cam_0"] == 0 and found["cam_1"] > 0


def test_a_lone_camera_has_none(tmp_path):
    assert starts(written(tmp_path, toy.records(TIMES, toy.CAMERAS[:1]))) == {"cam_0": None}


def test_the_file_and_then_the_key_decide(tmp_path):
    folder = written(tmp_path, toy.records(TIMES))
    path = folder / "transforms.json"
    content = json.loads(path.read_text())
    for frame in content["frames"]:
        if frame["camera"] == "cam_1":
            frame["clip_start"] = 0.25
    path.write_text(json.dumps(content))
    found = starts(folder)
    assert found["cam_1"] == 0.25 and found["cam_0"] == 0
    assert set(map(float, starts(folder, clip_start=0.5).values())) == {0.5}


def test_a_wrong_value_is_refused_with_its_key(tmp_path):
    folder = written(tmp_path, toy.records(TIMES))
    with pytest.raises(CaptureError, match=r"capture\.clip_start .* at least 0"):
        starts(folder, clip_start=-1.0)
    path = folder / "transforms.json"
    content = json.loads(path.read_text())
    path.write_text(json.dumps(content | {"clip_start": -2}))
    with pytest.raises(CaptureError, match=r"transforms\.json.*clip_start must be at least 0"):
        starts(folder)
