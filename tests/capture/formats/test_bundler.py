"""Photographs with the cameras of Bundler."""

import time

import numpy as np
import pytest
from known_photograph import (
    PIXELS,
    SHIFT,
    TO_CAMERA,
    H,
    W,
    distorted,
    pixels,
    seen_points,
    write_picture,
)

from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.formats import bundler
from gaussray.capture.formats.bundler import read_bundler
from gaussray.capture.open import format_of, open_capture
from gaussray.color import srgb_decode
from gaussray.io.safe.limits import Limits, limit, limits


# To the axes of Bundler's cameras: +y up, looking along -z.
FLIP = np.diag([1.0, -1, -1])
FOCAL, K1, K2 = 50.0, -0.12, 0.09
LEVELS = np.arange(60).reshape(20, 3)
LIST = "./a.png 0 51.5\nb.png 0 51.5\nc.png\n"


def row(*numbers):
    return " ".join(f"{x:.12g}" for x in np.ravel(numbers)) + "\n"


def camera(focal=FOCAL, turn=TO_CAMERA, shift=SHIFT):
    rows = [row([focal, K1, K2]), *map(row, FLIP @ turn), row(FLIP @ shift)]
    return "".join(rows if focal else [row([0, 0, 0])] * 5)


def measured():
    """Where the camera sees points, from the middle of the picture and upwards."""
    world, own = seen_points()
    return world, FOCAL * distorted(own, K1, K2) * [1, -1]


def model(cameras=None, points=None, header="# Bundle file v0.3"):
    """Bundler's text of two registered cameras of one place and a third one of none."""
    cameras = [camera(), camera(), camera(focal=0)] if cameras is None else cameras
    if points is None:
        points = [
            row(x) + row(c) + row([2, 0, k, *at, 1, k, *at])
            for k, (x, c, at) in enumerate(zip(measured()[0], LEVELS, measured()[1], strict=True))
        ]
    return f"{header}\n{len(cameras)} {len(points)}\n" + "".join([*cameras, *points])


def lay(folder, text, listed=LIST, place="prepare/list.txt"):
    for name, content in (("bundle/bundle.out", text), (place, listed)):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(content)


@pytest.fixture
def few():
    """Limits of few pictures and points."""
    before = limits()
    limit(Limits(frames=3, points=1.0))
    yield
    limit(before)


@pytest.fixture
def folder(tmp_path):
    write_picture(tmp_path / "a.png")
    write_picture(tmp_path / "b.png", H, W)  # upright
    return tmp_path


@pytest.mark.parametrize(
    "place", ["prepare/list.txt", "list.txt", "bundle/list.txt", "bundle/prepare/list.txt"]
)
def test_points_fall_where_bundler_measured_them(folder, place):
    lay(folder, model(), place=place)
    assert format_of(folder) == "bundler"
    with pytest.warns(CaptureWarning, match="bundle.out: 1 of 3 pictures have no pose: left out"):
        capture = open_capture(folder)
    world, place = measured()
    assert [view.camera_name for view in capture.views] == ["a", "b"]
    for view, size in zip(capture.views, [(W, H), (H, W)], strict=True):
        assert (view.width, view.height) == size
        expected = np.array(size) / 2 + place * [1, -1]
        np.testing.assert_allclose(pixels(view, world), expected, atol=PIXELS)
    np.testing.assert_allclose(capture.points.position, world, rtol=1e-5)
    np.testing.assert_allclose(capture.points.color, srgb_decode(LEVELS / 255), rtol=1e-5)


def test_pictures_are_found_in_images_and_names_may_have_blanks(tmp_path):
    write_picture(tmp_path / "images/a 1.png")
    (tmp_path / "bundle.out").write_text(model([camera()], []))
    (tmp_path / "list.txt").write_text("/home/someone/a 1.png 0 51.5\n")
    says = "list.txt, line 1: no picture is where the path says. 1 of 1 are found if"
    with pytest.warns(CaptureWarning, match=says):
        capture = open_capture(tmp_path)
    assert [view.image for view in capture.views] == [tmp_path / "images/a 1.png"]
    assert capture.points is None


@pytest.mark.parametrize(
    ("text", "listed", "says"),
    [
        (model()[:-30], LIST, "bundle.out: must hold 3 cameras and 20 points, .* but is cut off"),
        (model()[:400], LIST, "bundle.out: must hold 3 cameras and 20 points, .* but is cut off"),
        (model(points=[row([0, 0, 0, 1, 2, 3, -1])]), LIST, "must hold 3 cameras and 1 points"),
        (model(points=[row([0, 0, 0, 1, 2, 3, np.inf])]), LIST, "3 cameras and 1 points"),
        (model().replace("0 0 0", "0 a 0"), LIST, "bundle.out: must hold numbers alone"),
        (model().replace("0 0 0", "0 1_0 0"), LIST, "bundle.out: must hold numbers alone"),
        (model() + "7 8\n", LIST, "20 points, as its second line says, but has other .* as 7"),
        ("# Bundle file v0.3\n", LIST, "its second line must have .*, got nothing"),
        ("# Bundle file v0.3\n-1 2\n0 0", LIST, "its second line must have .*, got -1, 2"),
        ("# Bundle file v0.3\n1.5 2\n0 0", LIST, "its second line must have .*, got 1.5, 2"),
        ("# Bundle file v0.3\nnan 2\n0 0", LIST, "its second line must have .*, got nan, 2"),
        (model(), "a.png\n", "list.txt: must have a line for each of the 3 cameras .*, got 1"),
        (model([camera(-1)] * 3), LIST, "camera 0: focal length must be above 0.* got -1"),
        (model([camera(np.nan)] * 3), LIST, "camera 0: focal length must be above 0.* got nan"),
        (model([camera(turn=-TO_CAMERA)] * 3), LIST, "camera 0: R must be a rotation"),
        (model([camera(focal=0)] * 3), LIST, "at least one picture must have a pose"),
        (model(points=[row([0, 0, 0, 1, 2, 300, 0])]), LIST, "point 0: points: color must be from"),
    ],
)
@pytest.mark.filterwarnings("ignore::gaussray.capture.errors.CaptureWarning")
def test_what_contradicts_the_format_is_refused_by_name(folder, text, listed, says):
    lay(folder, text, listed)
    with pytest.raises(CaptureError, match=says):
        read_bundler(folder)


def test_what_is_absent_is_named(folder):
    with pytest.raises(FileNotFoundError, match="holds no bundle.out of Bundler"):
        read_bundler(folder)
    lay(folder, model(), place="elsewhere/list.txt")
    with pytest.raises(FileNotFoundError, match="its list of pictures must be beside it"):
        read_bundler(folder)
    lay(folder, model())
    with pytest.raises(CaptureError, match=f"are in the folder around it. Name that one: {folder}"):
        open_capture(folder / "bundle")
    (folder / "a.png").unlink(), (folder / "b.png").unlink()
    lay(folder, model([camera(focal=0), camera()], []), listed="\nx.png\n./a.png 0 51.5\n")
    says = f"prepare/list.txt, line 3: must name a picture, got './a.png': neither .* in {folder}"
    with (
        pytest.warns(CaptureWarning, match="no pose"),
        pytest.raises(FileNotFoundError, match=says),
    ):
        read_bundler(folder)


def test_a_picture_outside_of_the_folder_is_named_by_the_list(folder, tmp_path_factory):
    other = tmp_path_factory.mktemp("other") / "c.png"
    write_picture(other)
    lay(folder, model([camera()], []), listed=f"{other} 0 51.5\n")
    says = f"list.txt, line 1: the picture must name a file in {folder}, .*limits.folders="
    with pytest.raises(CaptureError, match=says):
        read_bundler(folder)


def test_a_link_out_of_the_folder_is_named_by_the_list(folder, tmp_path_factory):
    other = tmp_path_factory.mktemp("other") / "c.png"
    write_picture(other)
    (folder / "images").mkdir()
    (folder / "images/c.png").symlink_to(other)
    lay(folder, model([camera()], []), listed="\nc.png\n")
    says = "list.txt, line 2: the picture must name a file in .*c.png is a link.*limits.folders="
    with pytest.warns(CaptureWarning, match="found"), pytest.raises(CaptureError, match=says):
        read_bundler(folder)


def test_a_model_may_begin_with_a_byte_order_mark_and_is_read_in_pieces(folder, monkeypatch):
    monkeypatch.setattr(bundler, "_PIECE", 7)
    lay(folder, "\ufeff" + model().replace("\n", "\r\n"))
    assert format_of(folder) == "bundler"
    with pytest.warns(CaptureWarning, match="1 of 3 pictures have no pose"):
        capture = read_bundler(folder)
    np.testing.assert_allclose(capture.points.position, measured()[0], rtol=1e-5)


def test_counts_are_compared_with_limits_before_the_rest_is_read(folder, few):
    for counts, says in (("9 0", "limits.frames=3"), ("1 5000000", "limits.points=1")):
        lay(folder, f"# Bundle file v0.3\n{counts}\n" + " " * 5_000_000 + "no number")
        with pytest.raises(ValueError, match=says):
            read_bundler(folder)


@pytest.mark.parametrize(
    ("line", "name"),
    [
        ("a b.jpg", "a b.jpg"),
        ("a.jpg 0 51.5", "a.jpg"),
        ("a  1.jpg\t0 5.15e+01", "a  1.jpg"),
        ("a.jpg 0", "a.jpg"),
        ("7 8 9", "7"),
        ("a.jpg 1_0", "a.jpg 1_0"),
        ("12.5", "12.5"),
    ],
)
def test_numbers_after_a_name_are_not_part_of_it(line, name):
    assert bundler._name_in(line) == name


def test_a_line_with_many_blanks_takes_no_time():
    line, begin = "a" + " " * 400_000 + "b", time.perf_counter()
    assert bundler._name_in(line) == line
    assert time.perf_counter() - begin < 1
