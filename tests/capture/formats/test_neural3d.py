"""Neural 3D Video: poses and videos of the published layout, and every way to spoil them."""

import films
import jax.numpy as jnp
import numpy as np
import pytest

from gaussray.camera.camera import project
from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.neural3d import read_neural3d
from gaussray.capture.open import format_of, open_capture
from gaussray.capture.view_file import check_images


# Single precision through lens and pose, in pixels.
PIXELS = 1e-3
W, H, COUNT = 48, 32, 5
# The files' pictures are twice as large as the videos', as in the published captures.
FOCAL = 90.0


def row(angle=0.0, height=2 * H, width=2 * W, focal=FOCAL):
    """A camera on a circle of radius 4 around the origin, its x axis to the right."""
    sin, cos = np.sin(angle), np.cos(angle)
    right, down, back = [cos, 0, sin], [0, -1, 0], [-sin, 0, cos]
    place = 4 * np.array(back)
    matrix = np.stack([down, right, back, place, [height, width, focal]], axis=1)
    return np.concatenate([matrix.reshape(-1), [1.0, 9.0]])


def lay(folder, angles=(0.0, 0.3, -0.4), count=COUNT):
    np.save(folder / "poses_bounds.npy", [row(angle) for angle in angles])
    for k in range(len(angles)):
        films.film(folder / f"cam{k:02d}.mp4", films.shades(count, W, H))
    return folder


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    return lay(tmp_path_factory.mktemp("neural3d"))


@pytest.fixture
def folder(original, tmp_path):
    """A copy to be spoilt."""
    for path in original.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    return tmp_path


def test_every_camera_films_all_frames_and_the_first_is_held_out(original):
    capture = read_neural3d(original)
    names = [name for name in ("cam00", "cam01", "cam02") for _ in range(COUNT)]
    assert [view.camera_name for view in capture.views] == names
    assert {view.camera_name for view in capture.views if view.split == "test"} == {"cam00"}
    times = [i / COUNT for i in range(COUNT)]
    assert [view.time for view in capture.views] == times * 3
    np.testing.assert_allclose([float(v.camera.time) for v in capture.views], times * 3, rtol=1e-7)
    assert (capture.time_range, capture.time_unit) == ((0.0, 0.8), "normalised")
    check_images(capture.views)
    assert [films.index_of(p) for p in films.load(capture.views)] == [*range(COUNT)] * 3


def test_a_point_lies_where_the_matrix_puts_it(original):
    for view, angle in zip(read_neural3d(original).views[::COUNT], (0.0, 0.3, -0.4), strict=True):
        matrix = row(angle)[:15].reshape(3, 5)
        for point in ([0, 0, 0], [0.5, -0.3, 0.2], [-0.4, 0.6, 1.0]):
            down, right, back = (np.array(point) - matrix[:, 3]) @ matrix[:, :3]
            x = W / 2 + FOCAL / 2 * right / -back
            y = H / 2 + FOCAL / 2 * down / -back
            found = project(view.camera, jnp.array(point, jnp.float32))
            np.testing.assert_allclose(found, (x, y), atol=PIXELS)


def test_the_videos_decide_the_size_and_scale_the_focal_length(folder):
    np.save(folder / "poses_bounds.npy", [row(a, 8 * H, 8 * W, 5.0) for a in (0, 0.3, 0.6)])
    view = read_neural3d(folder).views[0]
    assert (view.width, view.height) == (W, H)
    np.testing.assert_allclose(view.camera.lens.focal, [5 / 8, 5 / 8])
    np.testing.assert_allclose(view.camera.lens.center, [W / 2, H / 2])


def test_rows_go_with_the_videos_in_the_order_of_their_names(folder):
    (folder / "cam01.mp4").rename(folder / "cam17.mp4")
    views = read_neural3d(folder).views[::COUNT]
    assert [view.camera_name for view in views] == ["cam00", "cam02", "cam17"]
    place = np.array([view.camera.trajectory.translation[0] for view in views])
    expected = [row(angle)[:15].reshape(3, 5)[:, 3] for angle in (0.0, 0.3, -0.4)]
    np.testing.assert_allclose(place, expected, rtol=1e-6)


@pytest.mark.parametrize("name", ["points3D_downsample2.ply", "points3d.ply"])
def test_points_are_those_of_4dgaussians(folder, name):
    head = ["ply", "format ascii 1.0", "element vertex 1"]
    head += [f"property float {axis}" for axis in "xyz"]
    head += [f"property uchar {color}" for color in ("red", "green", "blue")]
    (folder / name).write_text("\n".join([*head, "end_header", "1 2 3 255 0 0", ""]))
    points = read_neural3d(folder).points
    np.testing.assert_array_equal(points.position, [[1, 2, 3]])
    np.testing.assert_array_equal(points.color, [[1, 0, 0]])


def test_the_folder_is_known_by_its_files(original):
    assert format_of(original) == "neural3d"
    capture = open_capture(original)
    assert len(capture.views) == 3 * COUNT


def broken(change):
    rows = np.array([row(angle) for angle in (0.0, 0.3, -0.4)])
    change(rows)
    return rows


def put(place, value):
    def change(rows):
        rows[1][place] = value

    return broken(change)


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        (np.zeros((3, 15)), r"real numbers \[cameras, 17\], got float64 \[3, 15\]"),
        (np.zeros(17), r"got float64 \[17\]"),
        (np.zeros((3, 17), int), "got int64"),
        (np.zeros((0, 17)), "as many as the videos .* got 0 and 3"),
        (np.array([row()] * 2), r"got 2 and 3 \(cam00.mp4, cam01.mp4, cam02.mp4\)"),
        (np.array([row()] * 4), "got 4 and 3"),
        (put(1, np.nan), r"row 1 \(cam01.mp4\) must be finite"),
        (put(3, np.inf), r"row 1 \(cam01.mp4\) must be finite"),
        (put(slice(0, 15, 5), 0.5), "row 1 .*cam01.mp4.* without shear"),
        (put(1, -np.cos(0.3)), "row 1"),
        (put(4, np.nan), "row 1 .*height, width and focal length above 0, got .nan"),
        (put(14, 0.0), "row 1 .*above 0"),
        (put(4, 2.0 * W), "cam01.mp4: the pictures must have the shape of 96 x 96"),
    ],
)
def test_poses_that_cannot_be_are_named(folder, rows, says):
    np.save(folder / "poses_bounds.npy", rows)
    with pytest.raises(CaptureError, match=says):
        read_neural3d(folder)


def test_a_file_that_is_no_array_or_promises_too_much(folder):
    path = folder / "poses_bounds.npy"
    good = path.read_bytes()
    malformed = good.replace(b"(3, 17)", b"(3, 17 ")
    huge = [
        good.replace(b"(3, 17), }" + b" " * len(rows), b"(3%s, 17), }" % rows)
        for rows in (b"0" * 11, b"0" * 20)
    ]
    assert all(len(data) == len(good) and data != good for data in (malformed, *huge))
    for data in (b"", b"hello", good[:60], good[:-8], malformed, *huge):
        path.write_bytes(data)
        with pytest.raises(CaptureError, match="poses_bounds.npy: the file must be a NumPy array"):
            read_neural3d(folder)
    np.savez(folder / "zip", np.zeros((3, 17)))
    (folder / "zip.npz").replace(path)
    with pytest.raises(CaptureError, match="poses_bounds.npy: the file must be a NumPy array"):
        read_neural3d(folder)
    np.save(path, np.array([{}], object), allow_pickle=True)
    with pytest.raises(CaptureError, match="poses_bounds.npy: the file must be a NumPy array"):
        read_neural3d(folder)


def test_missing_files_are_named(folder, tmp_path):
    (folder / "cam01.mp4").unlink()
    with pytest.raises(CaptureError, match="got 3 and 2 .cam00.mp4, cam02.mp4.*Copy the missing"):
        read_neural3d(folder)
    for name in ("cam00.mp4", "cam02.mp4"):
        (folder / name).unlink()
    assert format_of(folder) == "neural3d"
    with pytest.raises(CaptureError, match="got 3 and 0 .none."):
        read_neural3d(folder)
    (folder / "poses_bounds.npy").unlink()
    with pytest.raises(FileNotFoundError, match="poses_bounds.npy: the file with the cameras'"):
        read_neural3d(folder)


def test_a_video_that_is_cut_off_or_shorter_than_the_others(folder):
    films.film(folder / "cam02.mp4", films.shades(COUNT - 1, W, H))
    with pytest.raises(CaptureError, match="cam02.mp4: all videos .* got 4, but 5 in cam00.mp4"):
        read_neural3d(folder)
    films.cut(folder / "cam02.mp4", 0.9)
    with pytest.raises(OSError, match="cam02.mp4: the video is truncated"):
        read_neural3d(folder)
