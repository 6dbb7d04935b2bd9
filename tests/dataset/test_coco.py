"""COCO files of a dataset, read by pycocotools where it is installed; camera paths as TUM's."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gaussray.dataset.coco import run_lengths
from gaussray.dataset.images import write_image
from gaussray.dataset.layers import write_integers
from gaussray.dataset.layouts import write_layout


# Decimals of a line of groundtruth.txt.
DECIMALS = 1e-8


@pytest.fixture
def data(tmp_path):
    """A sample of two frames with two bodies."""
    group = np.ones((5, 7), int)
    group[1:3, 2:6], group[4, 0] = 3, 5
    turn = Rotation.from_rotvec([0.1, -0.7, 0.4]).as_matrix()
    frames = []
    for i, codes in enumerate((group, np.roll(group, 1, axis=1))):
        write_image(tmp_path / f"takes/000004/a{i}.png", np.full((5, 7, 3), 9 * i, np.uint8))
        write_integers(tmp_path / f"takes/000004/g{i}.png", codes)
        pose = np.eye(4)
        # OpenGL axes: up and backward.
        pose[:3, :3], pose[:3, 3] = turn * [1, -1, -1], [i, 2, 3]
        frames.append(
            {"file_path": f"a{i}.png", "labels": {"group": f"g{i}.png"}, "w": 7, "h": 5}
            | {"time": 0.5 * i, "transform_matrix": pose.tolist()}
        )
    line = {"version": 1, "index": 4, "folder": "takes/000004", "frames": frames}
    (tmp_path / "manifest.jsonl").write_text(json.dumps(line) + "\n")
    return tmp_path


def decoded(counts, size):
    values = np.repeat(np.arange(len(counts)) % 2, counts)
    return values.reshape(size[1], size[0]).T


def test_bodies_are_instances_with_their_masks_and_boxes(data, tmp_path):
    assert write_layout(data, tmp_path / "coco", "coco") == 2
    document = json.loads((tmp_path / "coco/instances.json").read_text())
    assert [one["file_name"] for one in document["images"]] == [
        "000004_0000.png",
        "000004_0001.png",
    ]
    first, other, *later = document["annotations"]
    assert (first["body"], other["body"]) == (0, 2) and first["image_id"] == 1
    assert first["bbox"] == [2, 1, 4, 2] and first["area"] == 8
    mask = np.zeros((5, 7), int)
    mask[1:3, 2:6] = 1
    region = first["segmentation"]
    np.testing.assert_array_equal(decoded(region["counts"], region["size"]), mask)
    assert [one["body"] for one in later] == [0, 2] and later[0]["bbox"] == [3, 1, 4, 2]


# The library does not yet know an argument of NumPy 2.
@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
def test_pycocotools_reads_the_masks(data, tmp_path):
    coco = pytest.importorskip("pycocotools.coco", reason="pip install pycocotools")
    write_layout(data, tmp_path / "coco", "coco")
    read = coco.COCO(str(tmp_path / "coco/instances.json"))
    (one,) = [a for a in read.loadAnns(read.getAnnIds(imgIds=[1])) if a["body"] == 0]
    mask = np.zeros((5, 7), int)
    mask[1:3, 2:6] = 1
    np.testing.assert_array_equal(read.annToMask(one), mask)


def test_runs_begin_with_zeros():
    assert run_lengths(np.array([[True, False], [True, True]])) == [0, 2, 1, 1]
    assert run_lengths(np.zeros((2, 2), bool)) == [4]


def test_the_path_of_the_camera_is_read_as_tum_does(data, tmp_path):
    assert write_layout(data, tmp_path / "tum", "tum") == 2
    folder = tmp_path / "tum/000004"
    lines = [x.split() for x in (folder / "rgb.txt").read_text().splitlines() if x[0] != "#"]
    assert [float(time) for time, _ in lines] == [0.0, 0.5]
    assert all((folder / name).is_file() for _, name in lines)
    table = np.loadtxt(folder / "groundtruth.txt")
    np.testing.assert_allclose(table[:, :4], [[0, 0, 2, 3], [0.5, 1, 2, 3]], atol=DECIMALS)
    # Camera axes right, down, forward.
    turn = Rotation.from_quat(table[0, 4:]).as_rotvec()
    np.testing.assert_allclose(turn, [0.1, -0.7, 0.4], atol=DECIMALS)


def test_a_dataset_without_groups_says_what_to_render(data, tmp_path):
    path = data / "manifest.jsonl"
    path.write_text(path.read_text().replace('"group"', '"valid"'))
    with pytest.raises(ValueError, match="needs the label group.*labels=.group"):
        write_layout(data, tmp_path / "coco", "coco")
