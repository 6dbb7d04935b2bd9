"""A scene is scored with the cameras that its fit found, where it refined them."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.capture.open import open_capture
from gaussray.dataset.images import write_image
from gaussray.dataset.manifest import FrameRecord, write_manifest
from gaussray.evaluate.found_cameras import with_found_cameras


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


def written(folder, views, cameras, refined):
    records = [
        FrameRecord(str(view.image.resolve()), camera, view.camera_name, view.split)
        for view, camera in zip(views, cameras, strict=True)
    ]
    write_manifest(folder / "cameras.json", records, extra={"info": {"refined": refined}})


def focal(capture):
    return [float(view.camera.lens.focal[0]) for view in capture.views]


def test_cameras_are_those_that_were_found_for_the_same_pictures(truth, tmp_path):
    run = tmp_path / "run"
    written(run, truth.views[::-1], [longer(view) for view in truth.views[::-1]], ["lens"])
    found = with_found_cameras(truth, run)
    np.testing.assert_allclose(focal(found), 1.1 * np.array(focal(truth)), rtol=1e-6)
    np.testing.assert_allclose(focal(with_found_cameras(truth, run / "scene.npz")), focal(found))
    assert [view.image for view in found.views] == [view.image for view in truth.views]
    first, other = truth.views
    # Another name, or another size of the picture, is another camera.
    renamed = dataclasses.replace(first, camera_name="cam7")
    written(run, [renamed, other], [longer(first), longer(other)], ["lens"])
    np.testing.assert_allclose(
        focal(with_found_cameras(truth, run)), np.array([1, 1.1]) * focal(truth), rtol=1e-6
    )


def test_without_refinement_and_without_a_run_they_are_as_recorded(truth, tmp_path):
    assert with_found_cameras(truth, tmp_path / "scene.npz") is truth
    written(tmp_path, truth.views, [longer(view) for view in truth.views], [])
    assert with_found_cameras(truth, tmp_path) is truth


def test_what_lies_beside_another_program_s_model_is_not_read(truth, tmp_path):
    (tmp_path / "cameras.json").write_text('{"cam0": {}}')
    assert with_found_cameras(truth, tmp_path / "scene.ply") is truth
