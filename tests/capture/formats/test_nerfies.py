"""Captures of Nerfies, HyperNeRF and DyCheck: cameras, times, splits and messages."""

import json

import jax.numpy as jnp
import numpy as np
import pytest

from gaussray.camera.camera import project
from gaussray.capture.errors import CaptureError
from gaussray.capture.open import format_of, open_capture
from gaussray.dataset.images import write_image


# A point and its pixel agree to this many pixels, in single precision.
PIXEL = 1e-4
SIZE, FOCAL, CENTER = (48, 32), 40.0, (25.0, 15.0)
# 1 + r^2 / 10 at a radius of 1/2, seen from camera b1.
BENT = 1 + 0.1 * 0.5**2
CAMERAS = {"a0": 0.0, "b0": 1.0, "a1": 2.0, "b1": 3.0}


def camera(x: float, **more) -> dict:
    """At (x, 0, 0), and turned by half a turn about the viewing axis: right is -x, down -y."""
    return {
        "orientation": [[-1, 0, 0], [0, -1, 0], [0, 0, 1]],
        "position": [x, 0.0, 0.0],
        "focal_length": FOCAL,
        "principal_point": list(CENTER),
        "skew": 0.0,
        "pixel_aspect_ratio": 1.5,
        "radial_distortion": [0.0, 0.0, 0.0],
        "tangential_distortion": [0.0, 0.0],
        "image_size": list(SIZE),
        **more,
    }


def lay(path, content):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content))


@pytest.fixture
def folder(tmp_path):
    """Two times by two cameras; the second camera is held out. The pictures are reduced by 2."""
    lay(tmp_path / "dataset.json", {"ids": list(CAMERAS), "train_ids": ["a0", "a1"],
                                    "val_ids": ["b0", "b1"], "count": 4})  # fmt: skip
    metadata = {
        name: {"warp_id": 3 + 4 * int(name[1]), "camera_id": int(name[0] == "b")}
        for name in CAMERAS
    }
    lay(tmp_path / "metadata.json", metadata)
    for name, x in CAMERAS.items():
        bent = {"radial_distortion": [0.1, 0.0, 0.0]} if name == "b1" else {}
        lay(tmp_path / f"camera/{name}.json", camera(x, **bent))
        for factor in (2, 4):
            size = SIZE[1] // factor, SIZE[0] // factor, 3
            write_image(tmp_path / f"rgb/{factor}x/{name}.png", np.full(size, 99, np.uint8))
    np.save(tmp_path / "points.npy", np.array([[1.0, 2.0, 3.0], [np.nan, 0.0, 0.0]]))
    return tmp_path


def test_cameras_times_splits_and_points(folder):
    assert format_of(folder) == "nerfies"
    capture = open_capture(folder)
    views = {view.image.stem: view for view in capture.views}
    assert {name: view.split for name, view in views.items()} == {
        "a0": "train", "a1": "train", "b0": "test", "b1": "test"
    }  # fmt: skip
    assert {name: view.time for name, view in views.items()} == {
        "a0": 0, "a1": 1, "b0": 0, "b1": 1
    }  # fmt: skip
    assert [views[name].camera_name for name in ("a0", "a1", "b1")] == ["cam0", "cam0", "cam1"]
    assert views["a0"].image.parent.name == "2x" and views["a0"].width == SIZE[0] // 2
    np.testing.assert_array_equal(capture.points.position, [[1, 2, 3]])
    # 1 to the right of camera a1, 1 down, 2 in front of it; half the pixels.
    pixel = project(views["a1"].camera, jnp.array([2.0 - 1, -1.0, 2.0]))
    right, down = CENTER[0] + FOCAL / 2, CENTER[1] + 1.5 * FOCAL / 2
    np.testing.assert_allclose(pixel, [right / 2, down / 2], atol=PIXEL)
    pixel = project(views["b1"].camera, jnp.array([3.0 - 1, 0.0, 2.0]))
    np.testing.assert_allclose(pixel[0], (CENTER[0] + BENT * FOCAL / 2) / 2, atol=PIXEL)


def test_dychecks_own_split_and_numbers_of_times_count_first(folder):
    lay(folder / "splits/train.json", {"frame_names": ["a0"], "time_ids": [0], "camera_ids": [0]})
    lay(folder / "splits/val.json", {"frame_names": ["b1"], "time_ids": [1], "camera_ids": [1]})
    metadata = json.loads((folder / "metadata.json").read_text())
    metadata["b1"]["time_id"] = 3
    lay(folder / "metadata.json", metadata)
    views = open_capture(folder).views
    assert [(view.image.stem, view.split, view.time) for view in views] == [
        ("a0", "train", 0), ("b1", "test", 0)
    ]  # fmt: skip


def test_without_lists_all_pictures_are_for_training(folder):
    lay(folder / "dataset.json", {"ids": list(CAMERAS)})
    assert {view.split for view in open_capture(folder).views} == {"train"}


@pytest.mark.parametrize(
    ("file", "change", "says"),
    [
        (
            "camera/a1.json",
            {"orientation": [1, 2]},
            r"a1\.json.*orientation must be a 3 x 3",
        ),
        ("camera/a1.json", {"orientation": np.diag([1, 1, -1]).tolist()}, r"a1\.json: orientation"),
        ("camera/a1.json", {"skew": 1.0}, r"a1\.json.*skew must be 0"),
        ("camera/a1.json", {"position": [1, 2]}, r"a1\.json.*position"),
        ("camera/a1.json", {"image_size": [0, 5]}, "image_size must be two numbers above 0"),
        ("metadata.json", {"a1": 5}, r'metadata\.json: "a1" must be a block of keys'),
        ("metadata.json", {"a1": {"camera_id": 0}}, r"metadata\.json.*warp_id"),
        ("dataset.json", {"train_ids": 3}, r"dataset\.json.*train_ids must be a list of names"),
        ("dataset.json", {"train_ids": ["../a1"]}, r"dataset\.json"),
    ],
)
def test_what_is_wrong_is_named(folder, file, change, says):
    content = json.loads((folder / file).read_text())
    lay(folder / file, content | change)
    if file == "dataset.json" and change["train_ids"] == ["../a1"]:
        metadata = json.loads((folder / "metadata.json").read_text())
        lay(folder / "metadata.json", metadata | {"../a1": metadata["a1"]})
    with pytest.raises(CaptureError, match=says):
        open_capture(folder)


def test_a_missing_folder_of_pictures_and_a_missing_camera_are_named(folder):
    (folder / "camera/a1.json").unlink()
    with pytest.raises(FileNotFoundError, match=r"camera/a1\.json"):
        open_capture(folder)
    (folder / "rgb").rename(folder / "pictures")
    with pytest.raises(FileNotFoundError, match="rgb: there is no folder 1x, 2x"):
        open_capture(folder)
