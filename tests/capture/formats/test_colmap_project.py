"""Projects with several models of COLMAP: the one whose pictures lie there is read."""

import colmaps
import pytest

from gaussray.capture.formats.colmap_project import project_folder


CAMERAS = {1: ("PINHOLE", 40, 30, (50.0, 51.0, 20.5, 14.5))}
POSE = (1.0, 0.0, 0.0, 0.0), (0.1, 0.2, 0.3)


def project(folder, names, form="bin"):
    """A project whose two models name the same pictures; those of the second one exist."""
    images = [(name, *POSE, 1) for name in names]
    for place in ("sparse/0", "dense/sparse"):
        colmaps.lay(folder / place, CAMERAS, images, [], form)
    store(folder, [f"dense/images/{name}" for name in names])
    return folder


def store(folder, names):
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"")


@pytest.mark.parametrize("form", ["bin", "txt"])
@pytest.mark.parametrize(
    ("name", "held"),
    [
        ("a.png", "images/a.png"),
        ("a.png", "images/A.JPG"),
        ("cam.01.jpg", "images/cam.01/0000.png"),
        ("cam.01.jpg", "cam.01.mp4"),
        ("cam01/7.jpg", "images/cam01/0000.png"),
        ("cam01/7.jpg", "videos/cam01.mov"),
    ],
)
def test_a_project_with_pictures_of_its_model_is_read(tmp_path, form, name, held):
    project(tmp_path, ["b.png", name], form)
    store(tmp_path, ["b.txt", held])
    assert project_folder(tmp_path) == tmp_path


@pytest.mark.parametrize("name", ["images/a.png", "../a.png", f"{300 * 'a'}.png", "a.png"])
def test_a_project_without_a_picture_of_its_model_is_read_at_the_undistorted_ones(tmp_path, name):
    project(tmp_path, ["b.png"])
    (tmp_path / "images").mkdir()
    images = [(one, *POSE, 1) for one in ("images/c.png", name)]
    colmaps.lay(tmp_path / "sparse/0", CAMERAS, images, [], "bin")
    store(tmp_path, ["a.txt"])
    (tmp_path / "a").mkdir()
    assert project_folder(tmp_path) == tmp_path / "dense"


@pytest.mark.parametrize("kept", [0, 4, 40, 80, -4])
def test_a_damaged_model_of_a_project_has_no_pictures(tmp_path, kept):
    project(tmp_path, ["a.png", "b.png"])
    store(tmp_path, ["images/a.png"])
    for place, read in (("sparse/0", tmp_path / "dense"), ("dense/sparse", tmp_path)):
        path = tmp_path / place / "images.bin"
        path.write_bytes(path.read_bytes()[:kept])
        assert project_folder(tmp_path) == read


def test_only_the_first_pictures_of_a_model_are_sought(tmp_path):
    names = [f"{k:04d}.png" for k in range(400)]
    project(tmp_path, names)
    store(tmp_path, [f"images/{name}" for name in names[350:]])
    assert project_folder(tmp_path) == tmp_path / "dense"
    # What follows them is not read.
    path = tmp_path / "sparse/0/images.bin"
    path.write_bytes(path.read_bytes()[:-100])
    store(tmp_path, [f"images/{names[299]}"])
    assert project_folder(tmp_path) == tmp_path
