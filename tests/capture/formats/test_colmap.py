"""Captures of COLMAP: standing still, a folder or a video per camera, cameras that move."""

import colmaps
import films
import jax.numpy as jnp
import numpy as np
import pytest
from colmaps import PINHOLE, H, W, model, pictures, pose, registered
from scipy.spatial.transform import Rotation

from gaussray.camera.camera import project
from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.formats.colmap import read_colmap
from gaussray.capture.open import format_of, open_capture
from gaussray.capture.selection import Selection
from gaussray.capture.view_file import check_images
from gaussray.dataset.images import write_image


# Single precision through lens and pose, in pixels.
PIXELS = 2e-3
STATIC = pytest.mark.filterwarnings("ignore:.*the capture is taken as static")
# A point of the world, and the numbers of a distorted camera.
POINT = np.array([0.2, -0.3, 0.4])
K = (0.05, -0.02, 0.003, -0.002, 0.01, 0.002, 0.001, -0.003)


def seen(capture):
    """What each view shows, as (camera, time, index of the picture)."""
    check_images(capture.views)
    shown = [films.index_of(p) for p in films.load(capture.views)]
    return [(v.camera_name, v.time, i) for v, i in zip(capture.views, shown, strict=True)]


def by_hand(name, values, quat, translation):
    """COLMAP's own projection of POINT (its camera models, by its documentation)."""
    x, y, z = Rotation.from_quat([*quat[1:], quat[0]]).apply(POINT) + translation
    u, v = x / z, y / z
    if name.startswith("SIMPLE") or name.startswith("RADIAL"):
        focal, center, k = (values[0],) * 2, values[1:3], values[3:]
    else:
        focal, center, k = values[:2], values[2:4], values[4:]
    if name.endswith("FISHEYE"):
        r = np.hypot(u, v)
        theta = np.arctan(r)
        bent = theta * (1 + sum(c * theta ** (2 * i + 2) for i, c in enumerate(k)))
        u, v = u * bent / r, v * bent / r
    elif k:
        k1, k2, p1, p2, k3, k4, k5, k6 = (*k, *[0.0] * (8 - len(k)))
        s = u * u + v * v
        radial = (1 + k1 * s + k2 * s**2 + k3 * s**3) / (1 + k4 * s + k5 * s**2 + k6 * s**3)
        bent = 2 * p1 * u * v + p2 * (s + 2 * u * u), 2 * p2 * u * v + p1 * (s + 2 * v * v)
        u, v = u * radial + bent[0], v * radial + bent[1]
    return focal[0] * u + center[0], focal[1] * v + center[1]


@STATIC
@pytest.mark.parametrize("form", ["bin", "txt"])
@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("SIMPLE_PINHOLE", (60.0, 23.0, 17.0)),
        ("PINHOLE", (60.0, 62.0, 23.0, 17.0)),
        ("SIMPLE_RADIAL", (60.0, 23.0, 17.0, K[0])),
        ("RADIAL", (60.0, 23.0, 17.0, *K[:2])),
        ("OPENCV", (60.0, 62.0, 23.0, 17.0, *K[:4])),
        ("FULL_OPENCV", (60.0, 62.0, 23.0, 17.0, *K)),
        ("OPENCV_FISHEYE", (60.0, 62.0, 23.0, 17.0, *K[:4])),
        ("SIMPLE_RADIAL_FISHEYE", (60.0, 23.0, 17.0, K[0])),
        ("RADIAL_FISHEYE", (60.0, 23.0, 17.0, *K[:2])),
    ],
)
def test_a_point_lies_where_colmap_puts_it(tmp_path, name, values, form):
    images = registered("a.png", "b.png", "c.png")
    model(tmp_path, images, {1: (name, W, H, values)}, form)
    views = read_colmap(tmp_path).views
    for view, (_, quat, translation, _) in zip(views, images, strict=True):
        found = project(view.camera, jnp.array(POINT, jnp.float32))
        expected = by_hand(name, values, quat, translation)
        np.testing.assert_allclose(found, expected, atol=PIXELS)


@pytest.mark.parametrize("place", ["sparse/0", "sparse", "colmap/sparse/0", "."])
def test_registered_pictures_alone_are_a_static_capture(tmp_path, place):
    names = ("b.png", "a.png", "c.png")
    pictures(tmp_path / "images", *names)
    colmaps.lay(tmp_path / place, PINHOLE, registered(*names), [])
    assert format_of(tmp_path) == "colmap"
    with pytest.warns(CaptureWarning, match="images.bin: no camera has a folder or video"):
        capture = open_capture(tmp_path)
    assert seen(capture) == [("a", 0.0, 1), ("b", 0.0, 0), ("c", 0.0, 2)]
    assert {view.split for view in capture.views} == {"train"} and capture.points is None
    assert capture.time_range == (0.0, 0.0)


@STATIC
def test_pictures_in_one_folder_are_cameras_each(tmp_path):
    pictures(tmp_path / "images/shots", "1.png", "2.png")
    capture = read_colmap(model(tmp_path, registered("shots/1.png", "shots/2.png")))
    assert seen(capture) == [("1", 0.0, 0), ("2", 0.0, 1)]
    assert capture.points is not None


@pytest.mark.parametrize(
    ("root", "prefix", "names"),
    [
        ("images", "", ("cam00", "cam01")),
        ("images", "frames/", ("cam00", "cam01")),
        (".", "frames/", ("cam00", "cam01")),
        ("images", "left/", ("x/0", "y/0")),
    ],
)
def test_a_folder_per_camera_is_its_film(tmp_path, root, prefix, names):
    # Ten comes after nine, also without zeros.
    films_ = [f"{i}.png" for i in range(12)]
    for name in names:
        pictures(tmp_path / root / prefix / name, *films_)
        (tmp_path / root / prefix / name / "notes.txt").write_text("")
    images = registered(*(f"{prefix}{name}/{i}.png" for i, name in enumerate(names)))
    capture = read_colmap(model(tmp_path, images))
    cameras = [name.replace("/", "_") for name in names]
    assert seen(capture) == [(c, i / 12, i) for c in cameras for i in range(12)]
    place = np.array([view.camera.trajectory.translation[0] for view in capture.views])
    assert np.ptp(place[:12], axis=0).max() == 0 and np.abs(place[0] - place[12]).max() > 0.1


@pytest.mark.parametrize("where", [".", "videos", "images"])
@pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
def test_a_video_per_camera_is_its_film(tmp_path, where, suffix):
    (tmp_path / where).mkdir(exist_ok=True)
    for name in ("cam00", "cam01"):
        films.film(tmp_path / where / f"{name}{suffix}", films.shades(4, W, H))
    pictures(tmp_path / "images", "cam00.jpg.png")  # one picture is no film
    capture = open_capture(
        model(tmp_path, registered("cam00.jpg", "cam01.jpg")),
        selection=Selection(test=("cam01",), frames=(1, 3, 2), scale=0.5),
    )
    assert [(v.camera_name, v.time) for v in capture.views] == [
        ("cam00", 0.25), ("cam00", 0.75), ("cam01", 0.25), ("cam01", 0.75)
    ]  # fmt: skip
    assert [films.index_of(p) for p in films.load(capture.views)] == [1, 3, 1, 3]
    assert [v.split for v in capture.views] == ["train", "train", "test", "test"]


def test_a_picture_stands_for_the_folder_of_its_name_or_a_video_for_a_folder_of_one(tmp_path):
    pictures(tmp_path / "images/cam00", "0.png", "1.png")
    pictures(tmp_path / "images", "cam00.png")
    capture = read_colmap(model(tmp_path, registered("cam00.png")))
    assert seen(capture) == [("cam00", 0.0, 0), ("cam00", 0.5, 1)]
    other = tmp_path / "other"
    for name in ("a", "b"):
        pictures(other / "images" / name, "0.png")
        films.film(other / f"{name}.mp4", films.shades(3, W, H))
    capture = read_colmap(model(other, registered("a/0.png", "b/0.png")))
    assert seen(capture) == [(c, i / 3, i) for c in "ab" for i in range(3)]


def test_several_registered_pictures_of_one_place_are_one_camera(tmp_path):
    names = [f"{camera}/{i}.png" for camera in "ab" for i in range(3)]
    for camera in "ab":
        pictures(tmp_path / "images" / camera, *(f"{i}.png" for i in range(5)))
    images = registered(*names)
    still = [(name, *pose(3 * (k // 3))) for k, (name, *_) in enumerate(images)]
    jitter = [(n, q, (t[0] + 1e-5 * k, *t[1:]), 1) for k, (n, q, t) in enumerate(still)]
    assert seen(read_colmap(model(tmp_path, jitter))) == [
        (camera, i / 5, i) for camera in "ab" for i in range(5)
    ]


@pytest.mark.filterwarnings("ignore:.*at place 3 a has 3 and b 2")
def test_a_camera_that_moves_shows_what_is_registered_at_its_place_in_the_folder(tmp_path):
    for camera in "ab":
        pictures(tmp_path / "images" / camera, *(f"{i}.png" for i in range(4)))
    images = registered("a/0.png", "a/2.png", "a/3.png", "b/1.png", "b/2.png")
    capture = read_colmap(model(tmp_path, images))
    assert seen(capture) == [
        ("a_0", 0.0, 0), ("a_2", 0.5, 2), ("a_3", 0.75, 3), ("b_1", 0.25, 1), ("b_2", 0.5, 2)
    ]  # fmt: skip
    for view, (_, quat, translation, _) in zip(capture.views, images, strict=True):
        turn = Rotation.from_quat([*quat[1:], quat[0]])
        expected = -turn.inv().apply(translation)
        np.testing.assert_allclose(view.camera.trajectory.translation[0], expected, atol=1e-5)
        assert float(view.camera.time) == view.time
    chosen = open_capture(tmp_path, selection=Selection(test=("a_*",)))
    assert [view.split for view in chosen.views] == ["test"] * 3 + ["train"] * 2
    (tmp_path / "images/a/2.png").unlink()
    pictures(tmp_path / "images/a", "4.png")
    with pytest.warns(CaptureWarning, match="1 of 5 frames have no picture, such as .*a/2.png"):
        assert len(open_capture(tmp_path).views) == 4


def test_cameras_of_unequal_films_are_counted(tmp_path):
    films.film(tmp_path / "cam00.mp4", films.shades(4, W, H))
    images = registered("cam00.png", "cam01.png")
    with pytest.raises(CaptureError, match="as many frames, got cam00 4, cam01 1. Each needs"):
        read_colmap(model(tmp_path, images))
    films.film(tmp_path / "cam01.mp4", films.shades(3, W, H))
    with pytest.raises(CaptureError, match="got cam00 4, cam01 3"):
        read_colmap(tmp_path)
    films.cut(tmp_path / "cam01.mp4", 0.9)
    with pytest.raises(OSError, match="cam01.mp4: the video is truncated"):
        read_colmap(tmp_path)


@pytest.mark.parametrize(
    "name", ["../a.png", "a/../../b.png", "/etc/a.png", "C:\\a.png", "\\\\host\\a.png", "."]
)
@pytest.mark.parametrize("form", ["bin", "txt"])
def test_a_name_that_leaves_the_folder_is_refused(tmp_path, name, form):
    model(tmp_path, registered("a.png", name), form=form)
    with pytest.raises(CaptureError, match=f"images.{form}: the name of a picture must be a path"):
        read_colmap(tmp_path)


@pytest.mark.parametrize(
    ("quat", "translation"),
    [
        ((np.nan, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        ((1.0, 0.0, 0.0, 0.0), (0.0, np.inf, 0.0)),
        ((0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
    ],
)
@STATIC
def test_a_pose_that_is_none_is_named(tmp_path, quat, translation):
    with pytest.raises(CaptureError, match="images.bin: the pose of a.png must be finite"):
        read_colmap(model(tmp_path, [("a.png", quat, translation, 1)]))


@pytest.mark.parametrize(
    ("width", "values", "says"),
    [
        (W, (0.0, 60.0, 23.0, 17.0), "lens.focal must be above 0"),
        (W, (np.nan, 60.0, 23.0, 17.0), "fl_x must be a finite number"),
        (0, (60.0, 60.0, 23.0, 17.0), "w must be a whole number of at least 1"),
    ],
)
@STATIC
def test_a_camera_that_makes_no_lens_is_named(tmp_path, width, values, says):
    model(tmp_path, registered("a.png"), {1: ("PINHOLE", width, H, values)})
    with pytest.raises(CaptureError, match=f"images.bin, frame 0: {says}"):
        read_colmap(tmp_path)


@pytest.mark.parametrize("focal", [9.0, 1e6])
def test_a_lens_that_is_made_up_is_warned_of(tmp_path, focal):
    cameras = {3: ("PINHOLE", W, H, (focal, focal, 23.0, 17.0))}
    folder = model(tmp_path, registered("cam_0/0.png", "cam_1/0.png", camera=3), cameras)
    for name in ("cam_0", "cam_1"):
        pictures(folder / "images", f"{name}/0.png", f"{name}/1.png")
    with pytest.warns(CaptureWarning, match="camera 3 has a focal length"):
        read_colmap(folder)


@STATIC
def test_pictures_of_another_size_or_none(tmp_path):
    capture = read_colmap(model(tmp_path, registered("a.png", "b.png")))
    write_image(tmp_path / "images/a.png", np.zeros((H, W + 1, 3), np.uint8))
    with pytest.raises(CaptureError, match="(?s)a.png.*48 x 32.*got 49 x 32.*b.png: .* not exist"):
        check_images(capture.views)


@STATIC
def test_two_pictures_of_one_name(tmp_path):
    with pytest.raises(CaptureError, match="name of its own, got cam.png for cam again"):
        read_colmap(model(tmp_path, registered("cam.jpg", "cam.png")))
    with pytest.raises(CaptureError, match="name of its own, got a_b/0.png for a_b again"):
        read_colmap(model(tmp_path, registered("a/b/0.png", "a_b/0.png")))


def test_a_folder_without_a_model(tmp_path):
    with pytest.raises(FileNotFoundError, match="must hold cameras and images .* sparse/0"):
        read_colmap(tmp_path)


@STATIC
@pytest.mark.parametrize(("listed", "stored"), [("a.jpg", "a.JPG"), ("A.png", "a.tif")])
def test_pictures_that_are_spelt_otherwise_are_read(tmp_path, listed, stored):
    model(tmp_path, registered(listed))
    (tmp_path / "images").mkdir()
    (tmp_path / "images" / stored).write_bytes(b"")
    with pytest.warns(CaptureWarning, match=f"spelt otherwise .{stored} for {listed}"):
        capture = read_colmap(tmp_path)
    assert capture.views[0].image == tmp_path / "images" / stored


@STATIC
def test_models_with_more_pictures_and_pictures_without_pose_are_told(tmp_path):
    names = [f"{k}.png" for k in range(4)]
    model(tmp_path, registered(*names[:1]))
    for number, form in (("1", "bin"), ("2", "txt")):
        images = registered(*names[: 1 + int(number)])
        colmaps.lay(tmp_path / "sparse" / number, PINHOLE, images, [], form)
    for name in names:
        (tmp_path / "images").mkdir(exist_ok=True)
        (tmp_path / "images" / name).write_bytes(b"")
    with pytest.warns(CaptureWarning) as told:
        read_colmap(tmp_path)
    text = " ".join(str(one.message) for one in told)
    assert "more pictures (0 has 1, 1 has 2, 2 has 3)" in text
    assert f"3 of 4 pictures in {tmp_path / 'images'} have no pose" in text


def test_the_folder_of_a_model_is_not_taken_for_its_capture(tmp_path):
    model(tmp_path, registered("0.png"))
    (tmp_path / "images").mkdir()
    with pytest.raises(CaptureError, match=f"is the model of the capture {tmp_path}"):
        read_colmap(tmp_path / "sparse/0")


@STATIC
@pytest.mark.parametrize(("fl_y", "told"), [(62.0, False), (75.0, True)])
def test_pixels_that_are_not_square_are_told(tmp_path, recwarn, fl_y, told):
    cameras = {1: ("PINHOLE", W, H, (60.0, fl_y, 23.0, 17.0))}
    pictures(tmp_path / "images", "a.png", "b.png")
    read_colmap(model(tmp_path, registered("a.png", "b.png"), cameras))
    said = [str(one.message) for one in recwarn]
    assert any("camera 1 has pixels that are 1.25 times as wide as high" in x for x in said) == told


@STATIC
def test_a_model_of_hardly_any_of_the_pictures_is_told(tmp_path):
    model(tmp_path, registered("0.png", "1.png"))
    pictures(tmp_path, *(f"images/{k}.png" for k in range(2)))
    pictures(tmp_path, *(f"input/{k}.png" for k in range(20)))
    assert len(open_capture(tmp_path).views) == 2
    pictures(tmp_path, "input/20.png")
    says = r"only 2 of the 21 pictures in \S+input are .* prepare videos=\S+input out=OUT` finds"
    with pytest.warns(CaptureWarning, match=says):
        assert len(open_capture(tmp_path).views) == 2
