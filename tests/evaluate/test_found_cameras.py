"""A scene is scored with the cameras and exposures that its fit found, where it refined them."""

import dataclasses
import json

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.capture.errors import CaptureError
from gaussray.capture.open import open_capture
from gaussray.dataset.images import write_image
from gaussray.dataset.manifest import FrameRecord, write_manifest
from gaussray.evaluate.found_cameras import FoundCapture, with_found_cameras


ANGLES = (0.0, 0.4)


@pytest.fixture
def truth(tmp_path):
    records = []
    for number, angle in enumerate(ANGLES):
        camera, name = toy.camera(angle), f"images/{number}.png"
        size = camera.film.height, camera.film.width, 3
        write_image(tmp_path / "capture" / name, np.full(size, 99, np.uint8))
        records.append(FrameRecord(name, camera, f"cam{number}", "test" if number else "train"))
    write_manifest(tmp_path / "capture" / "transforms.json", records)
    return open_capture(tmp_path / "capture")


def longer(view, factor=1.1):
    lens = view.camera.lens
    return eqx.tree_at(lambda c: c.lens.focal, view.camera, jnp.float32(factor) * lens.focal)


def written(folder, views, cameras, refined, **info):
    records = [
        FrameRecord(str(view.image.resolve()), camera, view.camera_name, view.split)
        for view, camera in zip(views, cameras, strict=True)
    ]
    write_manifest(folder / "cameras.json", records, extra={"info": {"refined": refined, **info}})


def recorded(folder, views, **info):
    written(folder, views, [view.camera for view in views], [], **info)


def focal(capture):
    return [float(view.camera.lens.focal[0]) for view in capture.views]


def test_cameras_are_those_that_were_found_for_the_same_pictures(truth, tmp_path):
    run = tmp_path / "run"
    written(run, truth.views[::-1], [longer(view) for view in truth.views[::-1]], ["lens"])
    found = with_found_cameras(truth, run).capture
    np.testing.assert_allclose(focal(found), 1.1 * np.array(focal(truth)), rtol=1e-6)
    beside = with_found_cameras(truth, run / "scene.npz").capture
    np.testing.assert_allclose(focal(beside), focal(found))
    assert [view.image for view in found.views] == [view.image for view in truth.views]
    first, other = truth.views
    # Another name, or another size of the picture, is another camera.
    renamed = dataclasses.replace(other, camera_name="cam7")
    written(run, [first, renamed], [longer(first), longer(other)], ["lens"])
    np.testing.assert_allclose(
        focal(with_found_cameras(truth, run).capture),
        np.array([1.1, 1]) * focal(truth),
        rtol=1e-6,
    )


def test_without_refinement_and_without_a_run_they_are_as_recorded(truth, tmp_path):
    assert with_found_cameras(truth, tmp_path / "scene.npz").capture is truth
    written(tmp_path, truth.views, [longer(view) for view in truth.views], [])
    assert with_found_cameras(truth, tmp_path).capture is truth


def test_what_lies_beside_another_program_s_model_is_not_read(truth, tmp_path):
    (tmp_path / "cameras.json").write_text('{"cam0": {}}')
    assert with_found_cameras(truth, tmp_path / "scene.ply").capture is truth


def test_a_color_response_is_the_gain_times_the_matrix(truth, tmp_path):
    gain, matrix = [0.5, 1.0, 2.0], [[0.8, 0.2, 0.0], [0.1, 0.9, 0.0], [0.0, 0.3, 0.7]]
    first, other = truth.views
    recorded(tmp_path, truth.views, gain={"cam0": gain})
    found = with_found_cameras(truth, tmp_path)
    np.testing.assert_allclose(found.response(first), np.diag(gain))
    assert found.response(other) is None
    recorded(tmp_path, truth.views, gain={"cam0": gain}, color_matrix={"cam0": matrix})
    both = with_found_cameras(truth, tmp_path).response(first)
    # A camera's red is half of what its matrix makes of red and green.
    np.testing.assert_allclose(both[0], [0.4, 0.1, 0.0])
    np.testing.assert_allclose(both[2], [0.0, 0.6, 1.4])
    recorded(tmp_path, truth.views, color_matrix={"cam0": matrix})
    np.testing.assert_allclose(with_found_cameras(truth, tmp_path).response(first), matrix)


def test_a_camera_of_the_same_name_in_another_folder_has_no_gain(truth, tmp_path):
    first, _ = truth.views
    elsewhere = dataclasses.replace(first, image=tmp_path / "other" / first.image.name)
    recorded(tmp_path, truth.views, gain={"cam0": [2.0, 2.0, 2.0]})
    found = with_found_cameras(truth, tmp_path)
    assert found.response(first) is not None and found.response(elsewhere) is None
    # Pictures at other times are by the same camera.
    later = dataclasses.replace(first, image=first.image.with_name("later.png"), time=0.5)
    assert found.response(later) is not None


def test_a_gain_that_is_not_three_numbers_is_refused(truth, tmp_path):
    for wrong in ([1.0, 2.0], "x", [float("inf")] * 3):
        recorded(tmp_path, truth.views)
        file = tmp_path / "cameras.json"
        content = json.loads(file.read_text())
        content["info"]["gain"] = {"cam0": wrong}
        file.write_text(json.dumps(content))
        with pytest.raises(CaptureError, match=r"info\.gain must hold 3 numbers"):
            with_found_cameras(truth, tmp_path)


def test_parts_tell_which_pictures_the_fit_saw(truth, tmp_path):
    first, other = truth.views
    later = dataclasses.replace(first, image=first.image.with_name("later.png"), time=0.5)
    # `other` is a training picture of the capture, but was held out from the fit.
    shown = dataclasses.replace(other, split="train")
    capture = dataclasses.replace(truth, views=[first, later, shown])
    recorded(tmp_path, truth.views)
    found = with_found_cameras(capture, tmp_path)
    parts = [found.part(view) for view in capture.views]
    assert parts == ["train", "held_out_times", "held_out_cameras"]
    # What a fit of another capture saw tells nothing: splits count.
    moved = dataclasses.replace(first, image=tmp_path / "elsewhere" / "0.png")
    recorded(tmp_path, [moved])
    found = with_found_cameras(capture, tmp_path)
    assert [found.part(view) for view in capture.views] == ["train"] * 3
    test = dataclasses.replace(later, split="test")
    assert found.part(test) == "held_out_times" and found.part(other) == "held_out_times"
    assert FoundCapture(truth).part(other) == "held_out_cameras"
