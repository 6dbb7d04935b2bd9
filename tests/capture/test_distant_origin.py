"""Captures in map coordinates, against the same capture near the origin of its world."""

import json
import warnings

import numpy as np
import pytest

from gaussray.capture.errors import CaptureWarning
from gaussray.capture.open import open_capture
from gaussray.dataset.images import write_image


# Metres east, north and above the sea; 32 bits tell half a metre there.
MAP = np.array([431042.7, 5403017.3, 211.9])
# A step of single precision within a hundred units of the origin is shorter.
CLOSE = 1e-5


def capture(folder, place, apart=0.3, count=4):
    """Cameras beside each other, one of which goes along a path, and two points."""
    frames = []
    for k in range(count):
        matrix = np.eye(4)
        matrix[:3, 3] = place + [apart * k, 0.1 * apart * k**2, 0]
        write_image(folder / f"images/{k}.png", np.full((4, 6, 3), 90, np.uint8))
        frames.append({"file_path": f"images/{k}.png", "split": "train", "time": 0.0})
        still = {"transform_matrix": matrix.tolist()}
        path = {"trajectory": [{"time": t, **still} for t in (0.0, 1.0)]}
        frames[-1] |= path if k == count - 1 else still
    lens = {"fl_x": 6.0, "fl_y": 6.0, "cx": 3.0, "cy": 2.0, "w": 6, "h": 4}
    (folder / "transforms.json").write_text(json.dumps({**lens, "frames": frames}))
    head = ["ply", "format ascii 1.0", "element vertex 2"]
    head += [f"property double {axis}" for axis in "xyz"]
    head += [f"property uchar {color}" for color in ("red", "green", "blue")]
    rows = [" ".join(f"{x:.9f}" for x in place + [0, 0, -z]) + " 9 9 9" for z in (1, 2)]
    (folder / "points3d.ply").write_text("\n".join([*head, "end_header", *rows, ""]))
    return folder


def eyes(opened):
    every = [np.asarray(view.camera.trajectory.translation) for view in opened.views]
    return np.concatenate(every).astype(np.float64)


def test_positions_in_map_coordinates_are_counted_from_a_round_place_nearby(tmp_path):
    for name, place in (("near", np.zeros(3)), ("far", MAP)):
        (tmp_path / name).mkdir()
        capture(tmp_path / name, place)
    near = open_capture(tmp_path / "near")
    with pytest.warns(CaptureWarning, match=r"counted from \(431000, 5403000, 200\)") as caught:
        far = open_capture(tmp_path / "far")
    assert len(caught) == 1
    moved = MAP - [431000, 5403000, 200]
    np.testing.assert_allclose(eyes(far), eyes(near) + moved, atol=CLOSE)
    np.testing.assert_allclose(far.points.position, near.points.position + moved, atol=CLOSE)
    assert far.points.position.dtype == np.float32


@pytest.mark.parametrize(
    ("place", "apart"),
    [((60_000, 0, 0), 100.0), ((5, 0, 0), 0.0), ((5, 0, 0), 1e-5), ((0, 0, 0), 1e-3)],
)
def test_of_cameras_near_the_origin_or_far_apart_the_world_stays(tmp_path, place, apart):
    # Also of one on a tripod that trembles.
    capture(tmp_path, np.array(place, float), apart)
    with warnings.catch_warnings():
        warnings.simplefilter("error", CaptureWarning)
        opened = open_capture(tmp_path)
    np.testing.assert_allclose(eyes(opened)[0], place)


def test_cameras_at_one_distant_place_are_brought_near(tmp_path):
    capture(tmp_path, MAP, apart=0.0)
    with pytest.warns(CaptureWarning, match="counted from"):
        opened = open_capture(tmp_path)
    assert np.abs(eyes(opened)).max() < 100
