"""Pictures of one time in a capture of COLMAP with a folder for each camera."""

import pytest
from colmaps import model, pictures, registered

from gaussray.capture.errors import CaptureWarning
from gaussray.capture.formats.colmap import read_colmap


def test_pictures_of_one_number_are_of_one_time(tmp_path):
    numbers = {"a": range(10), "b": [2, 3, 4, *range(7, 14)], "c": range(4, 13)}
    for name, own in numbers.items():
        pictures(tmp_path / "images" / name, *(f"{n:03d}.png" for n in own), first=own[0])
    model(tmp_path, registered(*(f"{name}.png" for name in numbers)))
    with pytest.warns(CaptureWarning, match="all have 4; left out are 6 of a, 6 of b, 5 of c"):
        capture = read_colmap(tmp_path)
    times = (0, 1 / 2, 2 / 3, 5 / 6)
    stored = [(v.camera_name, v.time, int(v.image.stem)) for v in capture.views]
    expected = [(c, t, n) for c in "abc" for t, n in zip(times, (4, 7, 8, 9), strict=True)]
    assert [one[::2] for one in stored] == [one[::2] for one in expected]
    assert [one[1] for one in stored] == pytest.approx([one[1] for one in expected])
    assert [float(v.camera.time) for v in capture.views] == pytest.approx(list(times) * 3)


@pytest.mark.parametrize("moves", [False, True])
def test_numbers_that_are_not_used_are_told(tmp_path, moves):
    # Folders that differ by a constant alone, and a camera that moves.
    for name, first in (("a", 0), ("b", 1)):
        numbers = [n + first + (moves and name == "b" and n == 3) for n in range(4)]
        pictures(tmp_path / "images" / name, *(f"{n}.png" for n in numbers))
    model(tmp_path, registered("a/0.png", "a/2.png", "b/1.png") if moves else registered("a", "b"))
    with pytest.warns(CaptureWarning, match="may not be: a begins with 0 and b with 1. If they"):
        capture = read_colmap(tmp_path)
    assert [v.time for v in capture.views] == (
        [*((0, 0.5) if moves else (0, 0.25, 0.5, 0.75)), 0, 0.25, 0.5, 0.75]
    )


@pytest.mark.filterwarnings("ignore:.*left out are")
def test_that_one_folder_begins_with_zero_and_another_with_one_is_told(tmp_path):
    for name, own in (("a", [0, 1, 2, 4]), ("b", [1, 2, 3, 4])):
        pictures(tmp_path / "images" / name, *(f"{n}.png" for n in own))
    model(tmp_path, registered("a", "b"))
    with pytest.warns(CaptureWarning, match="another with 1: a begins with 0 and b with 1. If"):
        capture = read_colmap(tmp_path)
    assert [v.time for v in capture.views] == [0, 0.25, 0.75] * 2
