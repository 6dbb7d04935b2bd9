"""Views are read from a capture, or from beside the scene."""

import json

import numpy as np
import pytest
import toy

from gaussray.dataset.images import write_image
from gaussray.dataset.manifest import write_manifest
from gaussray.render.rig.view_files import load_views


def test_cameras_come_from_a_capture_or_from_beside_the_scene(tmp_path):
    write_manifest(tmp_path / "cameras.json", toy.records())
    assert len(load_views(tmp_path, None)) == 12
    assert len(load_views(tmp_path / "scene.npz", None)) == 12
    with pytest.raises(FileNotFoundError, match="cameras=DIR"):
        load_views(tmp_path / "none" / "scene.npz", None)


def test_cameras_of_a_capture_in_splits(tmp_path):
    pose = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]
    for split in ("train", "test"):
        write_image(tmp_path / split / "r_0.png", np.full((12, 16, 3), 0.5))
        frame = {"file_path": f"./{split}/r_0", "time": 0.5, "transform_matrix": pose}
        content = {"camera_angle_x": 0.8, "frames": [frame]}
        (tmp_path / f"transforms_{split}.json").write_text(json.dumps(content))
    views = load_views(tmp_path / "none", tmp_path)
    assert [view.split for view in views] == ["train", "test"]
    assert (views[0].width, views[0].height, views[0].time) == (16, 12, 0.5)
