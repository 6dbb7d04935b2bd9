"""Captures of rigs: Google's immersive videos, Technicolor's, ActorsHQ."""

import json

import films
import jax.numpy as jnp
import numpy as np
import pytest
from skimage.io import imread

from gaussray.camera.camera import project
from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.formats.actorshq import read_actorshq
from gaussray.capture.formats.immersive import read_immersive
from gaussray.capture.formats.technicolor import read_technicolor
from gaussray.capture.open import format_of, open_capture
from gaussray.dataset.images import write_image


# Single precision through lens and pose, in pixels of pictures up to 2048 wide.
PIXELS = 2e-3
W, H = 32, 24
# A camera at (0.5, 0.2, -3) turned by 30 degrees around its y axis (down), camera to world.
ANGLE = np.pi / 6
PLACE = np.array([0.5, 0.2, -3.0])
POINT = np.array([-0.6, 0.4, 0.5])


def seen(place=PLACE, angle=ANGLE):
    """POINT in the camera's coordinates (OpenCV), by hand."""
    x, y, z = POINT - place
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * x - s * z, y, s * x + c * z])


def shade(path, number, size=(W, H)):
    path.parent.mkdir(parents=True, exist_ok=True)
    write_image(path, np.full((size[1], size[0], 3), 10 * number, np.uint8))


def shades(views):
    return [round(float(np.mean(imread(view.image))) / 10) for view in views]


def place_of(view):
    return np.asarray(project(view.camera, jnp.asarray(POINT, jnp.float32)))


# ---- Google's immersive videos


def model(name, **changes):
    camera = {"name": name, "width": W, "height": H, "projection_type": "fisheye"}
    camera |= {"focal_length": 12.0, "principal_point": [16.5, 11.0], "pixel_aspect_ratio": 1}
    camera |= {"radial_distortion": [0.05, -0.01, 0.0], "position": PLACE.tolist()}
    return camera | {"orientation": [0, -ANGLE, 0]} | changes


@pytest.fixture
def immersive(tmp_path):
    for k, name in enumerate(("camera_0001", "camera_0002")):
        films.film(tmp_path / f"{name}.mp4", films.shades(4, W, H) if k else films.shades(4, W, H))
    lay(tmp_path, [model("camera_0001"), model("camera_0002", position=[0, 0, -4])])
    return tmp_path


def lay(folder, models):
    (folder / "models.json").write_text(json.dumps(models))


def test_videos_of_fisheyes_are_cameras_and_the_middle_one_is_held_out(immersive):
    assert format_of(immersive) == "immersive"
    capture = open_capture(immersive)
    assert [(v.camera_name, v.split) for v in capture.views[::4]] == [
        ("camera_0001", "test"),
        ("camera_0002", "train"),
    ]
    assert [view.time for view in capture.views[:4]] == [0, 0.25, 0.5, 0.75]
    assert [films.index_of(p) for p in films.load(capture.views)] == [*range(4)] * 2
    # By hand: an equidistant fisheye with two coefficients.
    x, y, z = seen()
    theta = np.arctan2(np.hypot(x, y), z)
    radius = 12 * (theta + 0.05 * theta**3 - 0.01 * theta**5)
    expected = [16.5 + radius * x / np.hypot(x, y), 11 + radius * y / np.hypot(x, y)]
    np.testing.assert_allclose(place_of(capture.views[0]), expected, atol=PIXELS)


def test_extracted_frames_take_the_place_of_a_video(immersive):
    (immersive / "camera_0002.mp4").unlink()
    for i in range(4):
        shade(immersive / "camera_0002" / f"{i}.png", i)
    views = [v for v in read_immersive(immersive).views if v.camera_name == "camera_0002"]
    assert shades(views) == [0, 1, 2, 3]
    assert [view.time for view in views] == [0, 0.25, 0.5, 0.75]


@pytest.mark.parametrize(
    ("models", "says"),
    [
        ({"cameras": []}, "must be a list of at least one camera"),
        ([3], "must be a list of at least one camera"),
        ([model("camera_0001", focal_length=0)], "camera 0: lens.focal must be above 0"),
        ([model("camera_0001", focal_length="a")], "camera 0: focal_length must be a finite"),
        ([model("camera_0001", radial_distortion=[0.1])], "radial_distortion must be 2 to 4"),
        ([model("camera_0001", orientation=[0, 0])], "orientation must be a list of 3"),
        ([model("camera_0001", projection_type="ods")], "projection_type must be fisheye"),
        ([model("camera_0001", pixel_aspect_ratio=1.1)], "pixel_aspect_ratio must be 1"),
        ([model("../a")], "name must name a file in"),
        ([model("camera_0009")], "at least one of its 1 cameras .camera_0009"),
    ],
)
def test_what_contradicts_models_json_is_named(immersive, models, says):
    lay(immersive, models)
    with pytest.raises(CaptureError, match=says):
        read_immersive(immersive)


def test_another_models_json_is_no_capture(tmp_path):
    (tmp_path / "models.json").write_text('[{"model": "a"}]')
    with pytest.raises(CaptureError, match="immersive needs models.json"):
        format_of(tmp_path)


# ---- Technicolor

ROW = "1900 1024 544 1.01 0 {q} {t}"


def row(place=PLACE, angle=ANGLE):
    """World to camera: the inverse turn, and what it makes of the place."""
    q = [np.cos(angle / 2), 0, -np.sin(angle / 2), 0]
    c, s = np.cos(angle), np.sin(angle)
    t = -np.array([c * place[0] - s * place[2], place[1], s * place[0] + c * place[2]])
    return ROW.format(q=" ".join(map(repr, map(float, q))), t=" ".join(map(repr, map(float, t))))


@pytest.fixture
def technicolor(tmp_path):
    rows = [row(), *(row(np.array([0.1 * k, 0, -3.0]), 0.0) for k in range(1, 11))]
    text = "\n".join(["focal_length cx cy aspect skew qw qx qy qz tx ty tz", *rows, ""])
    (tmp_path / "cameras_parameters.txt").write_text(text)
    for frame in (3, 5, 9):
        for camera in range(11):
            shade(tmp_path / f"Room_undist_{frame:05d}_{camera:02d}.png", frame, (64, 34))
    return tmp_path


@pytest.mark.filterwarnings("ignore:.*scaled:gaussray.capture.errors.CaptureWarning")
def test_rows_are_cameras_and_frames_of_one_number_have_one_time(technicolor):
    assert format_of(technicolor) == "technicolor"
    (technicolor / "Room_undist_00005_00.png").unlink()
    capture = read_technicolor(technicolor)
    first = [view for view in capture.views if view.camera_name == "cam00"]
    assert [view.time for view in first] == [0, 2 / 3]
    assert shades(first) == [3, 9]
    held = {view.camera_name for view in capture.views if view.split == "test"}
    assert held == {"cam10"}
    assert len(capture.views) == 32
    x, y, z = seen()
    expected = [1024 + 1900 * x / z, 544 + 1.01 * 1900 * y / z]
    np.testing.assert_allclose(place_of(first[0]), expected, atol=PIXELS)


def test_smaller_pictures_of_technicolor_scale_their_lens(technicolor):
    with pytest.warns(CaptureWarning):
        view = open_capture(technicolor).views[0]
    assert (view.width, view.height) == (64, 34)
    x, y, z = seen()
    expected = [(1024 + 1900 * x / z) / 32, (544 + 1.01 * 1900 * y / z) / 32]
    np.testing.assert_allclose(place_of(view), expected, atol=PIXELS)


def test_pictures_may_lie_in_a_folder(technicolor):
    (technicolor / "images").mkdir()
    for path in technicolor.glob("*.png"):
        path.rename(technicolor / "images" / path.name)
    assert len(read_technicolor(technicolor).views) == 33


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "must have a row of numbers"),
        ("focal cx\n", "must have a row of numbers"),
        (f"{row()}\n1 2 3\n", "the row of camera 1 must be 12 numbers, got 1 2 3"),
        (f"{row()}\n{row().replace('1900', 'nan')}", "camera 1: numbers must be a list of 12"),
        (
            "1900 1024 544 1 0 0 0 0 0 0 0 0",
            "camera 0: numbers must be .* a quaternion",
        ),
        (f"{row().replace('1900', '-1900')}\n" * 11, "camera 0: lens.focal must be above 0"),
    ],
)
def test_what_contradicts_the_rows_is_named(technicolor, text, says):
    (technicolor / "cameras_parameters.txt").write_text(text)
    with pytest.raises(CaptureError, match=says):
        read_technicolor(technicolor)


def test_pictures_of_other_cameras_are_told(technicolor):
    (technicolor / "cameras_parameters.txt").write_text(row() + "\n" + row())
    with pytest.warns(CaptureWarning, match="of 9 cameras that it does not list .cam02, cam03"):
        read_technicolor(technicolor)


# ---- ActorsHQ

HEAD = "name, w, h, rx, ry, rz, tx, ty, tz, fx, fy, px, py"


def actor(name, w=W, h=H):
    x, y, z = PLACE
    return f"{name}, {w}, {h}, 0.0, {ANGLE!r}, 0.0, {x}, {y}, {z}, 1.5, 2.0, 0.5, 0.45"


@pytest.fixture
def actorshq(tmp_path):
    names = ("Cam001", "Cam002", "Cam003")
    (tmp_path / "calibration.csv").write_text("\n".join([HEAD, *map(actor, names), ""]))
    for name in names[:2]:
        for i in (15, 16):
            shade(tmp_path / "rgbs" / name / f"{name}_rgb{i:06d}.png", i + int(name[-1]))
            shade(tmp_path / "masks" / name / f"{name}_mask{i:06d}.png", i)
    return tmp_path


def test_a_table_lists_the_cameras_of_a_dome(actorshq):
    assert format_of(actorshq) == "actorshq"
    with pytest.warns(CaptureWarning, match="1 of 3 cameras have no pictures"):
        capture = open_capture(actorshq)
    told = [(v.camera_name, v.split, v.time) for v in capture.views]
    assert told == [
        ("Cam001", "test", 0),
        ("Cam001", "test", 0.5),
        ("Cam002", "train", 0),
        ("Cam002", "train", 0.5),
    ]
    x, y, z = seen()
    expected = [W / 2 + 1.5 * W * x / z, 0.45 * H + 2 * H * y / z]
    np.testing.assert_allclose(place_of(capture.views[0]), expected, atol=PIXELS)


def test_pictures_upright_and_across_stay_as_they_are(actorshq):
    table = [HEAD, actor("Cam001"), actor("Cam002"), actor("Cam003", H, W)]
    (actorshq / "calibration.csv").write_text("\n".join(table))
    for i in (15, 16):
        shade(actorshq / "rgbs" / "Cam003" / f"Cam003_rgb{i:06d}.png", i, (H, W))
    capture = open_capture(actorshq)
    assert {(view.width, view.height) for view in capture.views} == {(W, H), (H, W)}


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ("", "must have the columns name, w, h"),
        (HEAD, "got 0 rows"),
        ("name, w, h\nCam001, 3, 4", "1 rows without rx, ry"),
        (
            f"{HEAD}\n{actor('Cam001').replace('1.5', 'x')}",
            "camera 0: fx must be a number, got 'x'",
        ),
        (f"{HEAD}\n{actor('Cam001').replace('1.5', 'inf')}", "camera 0: fx must be a finite"),
        (f"{HEAD}\nCam001, 3", "camera 0: h must be a number"),
        (f"{HEAD}\n{actor('Cam001', 0)}", "camera 0: w must be a whole number"),
        (
            f"{HEAD}\n{actor('Cam001')}\n{actor('Cam001')}",
            "a name of its own, got 'Cam001' 2 times",
        ),
        (f"{HEAD}\n{actor('Cam009')}", "at least one of its 1 cameras .Cam009"),
    ],
)
def test_what_contradicts_the_table_is_named(actorshq, table, says):
    (actorshq / "calibration.csv").write_text(table)
    with pytest.raises(CaptureError, match=says):
        read_actorshq(actorshq)


def test_missing_files_of_cameras_are_named(tmp_path):
    for read, name in (
        (read_immersive, "models.json"),
        (read_technicolor, "cameras_parameters.txt"),
        (read_actorshq, "calibration.csv"),
    ):
        with pytest.raises(FileNotFoundError, match=name):
            read(tmp_path)
