"""Captures of IDR and NeuS: projections in an archive beside pictures and masks."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gaussray.camera.camera import project
from gaussray.capture.capture import viewpoints
from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.frames import visible_pixels
from gaussray.capture.open import format_of, open_capture
from gaussray.dataset.images import write_image


W, H, COUNT = 24, 16, 9
K = np.array([[30.0, 0, 13.0], [0, 28.0, 7.5], [0, 0, 1]])
# Single precision of the cameras.
PIXEL = 1e-3
pytestmark = pytest.mark.filterwarnings("ignore:.*each 8th of 9 is held out")


def projections():
    """K [R t] of cameras that look about, in OpenCV's axes."""
    random = np.random.default_rng(3)
    turns = Rotation.from_euler("xyz", random.uniform(-0.3, 0.3, (COUNT, 3))).as_matrix()
    places = random.normal(0, 0.3, (COUNT, 3, 1))
    return [K @ np.concatenate([r, -r @ c], 1) for r, c in zip(turns, places, strict=True)]


def write(folder, matrices, name="cameras_sphere.npz"):
    arrays = {}
    for k, matrix in enumerate(matrices):
        arrays[f"world_mat_{k}"] = np.concatenate([matrix, [[0, 0, 0, 1]]]).astype(np.float32)
        arrays[f"scale_mat_{k}"] = np.eye(4, dtype=np.float32)
    np.savez(folder / name, **arrays)


@pytest.fixture
def folder(tmp_path):
    # A projection means the same times any number.
    write(tmp_path, [(-2.5) ** k * matrix for k, matrix in enumerate(projections())])
    for k in range(COUNT):
        write_image(tmp_path / f"image/{k:06d}.png", np.full((H, W, 3), 10 * k, np.uint8))
    return tmp_path


def test_pixels_are_those_of_the_projections(folder):
    assert format_of(folder) == "neus"
    capture = open_capture(folder)
    assert [view.split for view in capture.views] == ["test", *["train"] * 7, "test"]
    assert viewpoints(capture.views) == list(range(COUNT))
    place = np.array([0.2, -0.1, 4.0])
    for view, matrix in zip(capture.views, projections(), strict=True):
        x, y, z = matrix @ [*place, 1]
        pixel = project(view.camera, jnp.asarray(place, jnp.float32))
        np.testing.assert_allclose(pixel, [x / z, y / z], atol=PIXEL)


def test_masks_belong_to_the_pictures_in_their_order(folder):
    for k in range(COUNT):
        mask = np.zeros((H, W, 3), np.uint8)
        mask[:, : k + 1] = 255
        write_image(folder / f"mask/{k:03d}.png", mask)
    with pytest.warns(CaptureWarning, match="white pixels of mask/ count"):
        views = open_capture(folder).views
    assert [int(visible_pixels(v).sum()) for v in views] == [H * (k + 1) for k in range(COUNT)]


def test_the_other_file_is_read_where_it_is_alone(folder):
    (folder / "cameras_sphere.npz").rename(folder / "cameras.npz")
    assert len(open_capture(folder).views) == COUNT


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda m: m.pop(), "for each picture of image/, got 8 and 9. Copy what is missing"),
        (lambda m: m.__setitem__(1, 0 * m[1]), "frame 1: world_mat_1 must be a 3 x 4 or 4 x 4"),
        (lambda m: m.__setitem__(2, m[2] * np.nan), "frame 2: world_mat_2 must be .*finite"),
        (
            lambda m: m.__setitem__(0, np.array([[1, 0.2, 0], [0, 1, 0], [0, 0, 1]]) @ m[0]),
            "world_mat_0 must be .* without skew",
        ),
    ],
)
def test_what_is_no_camera_is_named(folder, change, says):
    matrices = projections()
    change(matrices)
    write(folder, matrices)
    with pytest.raises(CaptureError, match=f"cameras_sphere.npz.*{says}"):
        open_capture(folder)


def test_a_file_that_is_no_archive_is_refused(folder):
    (folder / "cameras_sphere.npz").write_bytes(b"no archive")
    with pytest.raises(CaptureError, match="cameras_sphere.npz: the file must hold arrays"):
        open_capture(folder)
