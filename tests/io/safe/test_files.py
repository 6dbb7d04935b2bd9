"""Files of strangers are opened only where they may lie, and only if they are files."""

import os

import pytest

from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.paired import read_capture
from gaussray.io.safe.files import inside, opened, parse_json, read_json, read_text
from gaussray.io.safe.limits import Limits, limit, limits, within


@pytest.fixture
def small():
    """Limits that a test may lower; those before come back."""
    before = limits()
    yield lambda **changes: limit(Limits(**changes))
    limit(before)


def test_a_file_is_read(tmp_path):
    (tmp_path / "a").write_bytes(b"text")
    with opened(tmp_path / "a") as file:
        assert file.read() == b"text"


@pytest.mark.parametrize("kind", ["pipe", "folder", "device"])
def test_what_is_no_file_is_refused_and_not_waited_for(tmp_path, kind):
    path = tmp_path / "a.json"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    else:
        path.symlink_to("/dev/zero")
    with pytest.raises(OSError, match="a.json: (must be a file|cannot be opened)"):
        opened(path)


def test_a_capture_with_a_pipe_does_not_wait_for_it(tmp_path):
    os.mkfifo(tmp_path / "transforms.json")
    with pytest.raises(OSError, match="transforms.json: must be a file"):
        read_capture(tmp_path)


def test_a_text_that_is_too_long_is_refused_by_its_size(tmp_path, small):
    (tmp_path / "a.json").write_bytes(b" " * 2000)
    small(text=0.001)
    with pytest.raises(ValueError, match=r"a.json: the text in MB must be at most limits.text=0.0"):
        read_text(tmp_path / "a.json")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"[1, 2", "malformed JSON at line 1, column 6"),
        (b"\xff", "must be UTF-8"),
        (b"[" * 200 + b"]" * 200, "nested at most 100 deep"),
        (b"[" * 100_000, "nested at most 100 deep"),
    ],
)
def test_what_is_no_json_is_named(tmp_path, text, message):
    (tmp_path / "a.json").write_bytes(text)
    with pytest.raises(ValueError, match=f"a.json: .*{message}"):
        read_json(tmp_path / "a.json")


def test_whole_numbers_beyond_64_bits_are_fractions():
    assert parse_json("a", "[12, -3, " + "9" * 18 + "]") == [12, -3, 10**18 - 1]
    assert parse_json("a", "[" + "9" * 5000 + "]") == [float("inf")]
    assert parse_json("a", " null ") is None


@pytest.mark.parametrize("name", ["a.png", "./b/a.png", "b/../a.png", "new/c.png"])
def test_a_name_in_the_folder_is_its_path(tmp_path, name):
    assert inside(tmp_path, name, "list: file_path") == tmp_path / name


@pytest.mark.parametrize("name", ["/etc/passwd", "/dev/zero"])
def test_a_name_that_leaves_the_folder_is_refused(tmp_path, name):
    with pytest.raises(ValueError, match="^list: file_path must name a file in .*limits.folders="):
        inside(tmp_path, name, "list: file_path")


@pytest.mark.parametrize("name", ["../a.png", "b/../../a.png", "/none/x/a.png", "/D:\\x\\a.png"])
def test_a_name_outside_that_names_nothing_is_refused_with_where_it_may_be(tmp_path, name):
    rule = "^list: file_path must name a file in .* and does not exist."
    with pytest.raises(ValueError, match=rf"{rule} Correct the name\.$"):
        inside(tmp_path, name, "list: file_path")
    (tmp_path / "pictures").mkdir()
    (tmp_path / "pictures" / "a.png").write_bytes(b"")
    with pytest.raises(
        ValueError, match=f"{rule} A file of this name is .*pictures.a.png. Correct"
    ):
        inside(tmp_path, name, "list: file_path")


@pytest.mark.parametrize("name", ["a\0b", "a\nb", "a" * 5000, "9" * 5000])
def test_a_name_that_is_none_is_refused(tmp_path, name):
    with pytest.raises(ValueError, match="^list: file_path must be the name of a file"):
        inside(tmp_path, name, "list: file_path")


def test_a_link_may_stay_in_the_folder_and_not_leave_it(tmp_path, small):
    home, away = tmp_path / "home", tmp_path / "away"
    home.mkdir()
    away.mkdir()
    (home / "real.png").write_bytes(b"")
    (away / "a.png").write_bytes(b"")
    (home / "link.png").symlink_to(home / "real.png")
    (home / "out.png").symlink_to(away / "a.png")
    (home / "there").symlink_to(away)
    assert inside(home, "link.png", "x").is_file()
    for name in ("out.png", "there/a.png"):
        with pytest.raises(ValueError, match="limits.folders"):
            inside(home, name, "x")
    # Beyond a link, a folder may be read in other ways than by this name.
    with pytest.raises(ValueError, match=r"none.png \(there is a link\).*folders=\['.*away'\]"):
        inside(home, "there/none.png", "x")
    (home / "gone").symlink_to(tmp_path / "gone")
    with pytest.raises(ValueError, match="none.png and does not exist"):
        inside(home, "gone/none.png", "x")
    small(folders=(str(away),))
    assert inside(home, "out.png", "x").is_file() and inside(home, "there/a.png", "x").is_file()


def test_links_in_a_circle_are_refused(tmp_path):
    (tmp_path / "a").symlink_to(tmp_path / "b")
    (tmp_path / "b").symlink_to(tmp_path / "a")
    try:
        path = inside(tmp_path, "a", "x")
    except ValueError:
        return
    with pytest.raises(OSError, match="cannot be opened"):
        opened(path)


def test_limits_are_checked_and_named(small):
    within("a", "its channels", 64, "channels")
    small(channels=3)
    with pytest.raises(ValueError, match="a: its channels must be at most limits.channels=3, got"):
        within("a", "its channels", 4, "channels")
    for wrong, key in ((dict(text=0.0), "text"), (dict(folders=("",)), "folders")):
        with pytest.raises(ValueError, match=f"limits.{key} must be"):
            Limits(**wrong)


def test_a_capture_names_no_file_outside_of_its_folder(tmp_path):
    turn = "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]"
    shared = '"w": 4, "h": 3, "fl_x": 4, "fl_y": 4, "cx": 2, "cy": 1.5'
    for key in ("file_path", "mask_path", "depth_file_path"):
        named = {"file_path": "a/0.png", key: "/etc/passwd"}
        words = ", ".join(f'"{k}": "{v}"' for k, v in named.items())
        frame = (
            f'{{{words}, "time": 0, "camera": "a", "split": "train", "transform_matrix": {turn}}}'
        )
        (tmp_path / "transforms.json").write_text(f'{{{shared}, "frames": [{frame}]}}')
        with pytest.raises(CaptureError, match=f"frame 0: {key} must name a file in"):
            read_capture(tmp_path)
