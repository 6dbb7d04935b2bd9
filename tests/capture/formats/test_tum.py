"""Captures of TUM's RGB-D benchmark, and trajectories that SLAM programs write in its form."""

import numpy as np
import pytest
from known_photograph import PIXELS, PLACE, TURN, pixels, seen_points, write_picture
from scipy.spatial.transform import Rotation

from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.formats.posed_pictures import in_seconds
from gaussray.capture.formats.tum import read_tum, tum_near_miss
from gaussray.capture.open import format_of, open_capture


K = np.array([[50.0, 0, 31.5], [0, 52.0, 23.5], [0, 0, 1]])
QUAT = Rotation.from_matrix(TURN).as_quat()
STAMPS = ("1.000000", "1.033000", "1.066000")
COUNTED_FROM_0 = pytest.mark.filterwarnings("ignore:.*times are counted from the first one")


def row(time, place=PLACE, quat=QUAT):
    return " ".join([f"{time:.9f}", *(f"{x:.17g}" for x in (*place, *quat))])


def lay(folder, rows=None, name="groundtruth.txt"):
    for stamp in STAMPS:
        write_picture(folder / f"rgb/{stamp}.png")
    rows = [row(float(stamp)) for stamp in STAMPS] if rows is None else rows
    (folder / name).write_text("\n".join(["# timestamp tx ty tz qx qy qz qw", *rows, ""]))
    (folder / "calib.txt").write_text("50 52 31.5 23.5\n")
    return folder


def check_pixels(view, place=PLACE):
    world, own = seen_points(place=np.asarray(place))
    # The middle of the first pixel is 0 in the file, and 0.5 here.
    expected = (own @ K.T)[:, :2] / own[:, 2:] + 0.5
    np.testing.assert_allclose(pixels(view, world), expected, atol=PIXELS)


@pytest.mark.parametrize("name", ["groundtruth.txt", "KeyFrameTrajectory.txt"])
def test_pixels_and_times_are_those_of_the_trajectory(tmp_path, name):
    assert format_of(lay(tmp_path, name=name)) == "tum"
    capture = open_capture(tmp_path)
    assert [view.time for view in capture.views] == [1, 1.033, 1.066]
    assert {(view.camera_name, view.split) for view in capture.views} == {("tum", "train")}
    assert capture.time_unit == "seconds"
    check_pixels(capture.views[1])


def test_poses_between_two_are_interpolated_and_the_nearest_counts_elsewhere(tmp_path):
    # The first picture lies between two, the second after the last of these, and the third is far.
    rows = [row(0.99, PLACE - 1), row(1.01, PLACE + 1), row(1.02, 3 * PLACE), row(9, PLACE)]
    lay(tmp_path, rows)
    with pytest.warns(CaptureWarning) as told:
        views = open_capture(tmp_path).views
    assert len(told) == 1 and "1 of 3 pictures, first rgb/1.066000.png" in str(told[0].message)
    check_pixels(views[0])
    check_pixels(views[1], 3 * PLACE)


def test_a_list_gives_pictures_their_times(tmp_path):
    lay(tmp_path)
    (tmp_path / "rgb").rename(tmp_path / "color")
    lines = [f"{stamp} color/{stamp}.png" for stamp in STAMPS]
    (tmp_path / "rgb.txt").write_text("# color images\n" + "\n".join(reversed(lines)))
    assert [view.time for view in open_capture(tmp_path).views] == [1, 1.033, 1.066]
    (tmp_path / "rgb.txt").write_text(f"{lines[0]}\n2.0 ../a.png\n")
    rows = [row(1), row(2)]
    (tmp_path / "groundtruth.txt").write_text("\n".join(rows))
    with pytest.raises(CaptureError, match=r"must name a file in .*got '\.\./a\.png'"):
        open_capture(tmp_path)


@COUNTED_FROM_0
def test_nanoseconds_are_seconds(tmp_path):
    first = 1_403_636_579_763_555_584
    for k in range(3):
        write_picture(tmp_path / f"images/{first + 50_000_000 * k}.png")
    rows = [row(first + 50_000_000 * k) for k in range(3)]
    (tmp_path / "CameraTrajectory.txt").write_text("\n".join(rows))
    (tmp_path / "calib.txt").write_text("50 52 31.5 23.5 0 0 0 0\n")
    times = [view.time for view in open_capture(tmp_path).views]
    np.testing.assert_allclose(times, [0, 0.05, 0.1], atol=1e-6)


@pytest.mark.parametrize("kind", ["1", "2", "3"])
@pytest.mark.filterwarnings("ignore:.*turns back within the picture")
def test_the_lens_of_the_benchmarks_sequences_is_known(tmp_path, kind):
    folder = lay(tmp_path / f"rgbd_dataset_freiburg{kind}_desk")
    (folder / "calib.txt").unlink()
    lens = open_capture(folder).views[0].camera.lens
    assert float(lens.focal[0]) == pytest.approx({"1": 517.3, "2": 520.9, "3": 535.4}[kind])
    assert lens.distorted == (kind != "3")
    (folder / "camera-intrinsics.txt").write_text("50 0 31.5\n0 52 23.5\n0 0 1\n")
    check_pixels(open_capture(folder).views[0])


def test_without_a_lens_the_file_to_write_is_named(tmp_path):
    (lay(tmp_path) / "calib.txt").unlink()
    with pytest.raises(CaptureError, match=r"no file tells the lens .* Write \S+camera-intrinsics"):
        open_capture(tmp_path)


def test_poses_that_are_none_are_left_out(tmp_path):
    rows = [row(1, quat=(0, 0, 0, 0)), row(1.033, quat=1e-9 * QUAT), row(1.066, (np.nan, 0, 0))]
    lay(tmp_path, rows)
    # Of the neighbours at 33 ms none is near enough.
    with pytest.warns(CaptureWarning, match="2 of 3 pictures, first rgb/1.000000.png, have no val"):
        (view,) = open_capture(tmp_path).views
    check_pixels(view)


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("groundtruth.txt", f"{row(1)}\n1 2 3", "groundtruth.txt, line 2: it must be a timestamp"),
        ("groundtruth.txt", f"{row(1)}\n{row(2)[:-1]}x", "line 2: it must be a timestamp, the pos"),
        ("groundtruth.txt", row(500), "at most 0.02 s from a picture, but those of 1 poses are f"),
        (
            "groundtruth.txt",
            "\n".join(row(float(stamp), (1e35, 0, 0)) for stamp in STAMPS),
            "groundtruth.txt: pose must be at most 1e.30 from the origin",
        ),
        ("calib.txt", "1 2 3", "calib.txt: must be one line of four, eight or nine numbers"),
        ("calib.txt", "-1 1 1 1", "calib.txt: must be one line of four, eight or nine numbers"),
        ("calib.txt", "", "calib.txt: must be one line of four, eight or nine numbers"),
        ("rgb.txt", "1.0 rgb/a.png\nx", "rgb.txt, line 2: it must be a timestamp in seconds and"),
        ("rgb.txt", "1.0 rgb/a.png\n1.0 b.png", "of its own, got 1 s for b.png|for rgb/a.png and"),
    ],
)
def test_what_contradicts_the_format_is_named(tmp_path, name, text, says):
    lay(tmp_path)
    (tmp_path / name).write_text(text)
    with pytest.raises(CaptureError, match=says):
        open_capture(tmp_path)


def test_other_trajectories_are_told(tmp_path):
    lay(tmp_path)
    (tmp_path / "trajectory.txt").write_text(row(1))
    with pytest.warns(CaptureWarning, match=r"trajectory\.txt is not read\. Move this file away"):
        open_capture(tmp_path)


def test_other_folders_are_none_of_it(tmp_path):
    lay(tmp_path)
    for stamp in STAMPS:
        (tmp_path / f"rgb/{stamp}.png").rename(tmp_path / f"rgb/a{stamp}.png")
    with pytest.raises(CaptureError, match="is no capture of a known format"):
        open_capture(tmp_path)
    says = "groundtruth.txt has eight numbers .* It needs pictures in rgb/ or images/ with timest"
    with pytest.raises(CaptureError, match=says):
        open_capture(tmp_path)
    with pytest.raises(FileNotFoundError, match=says):
        read_tum(tmp_path)
    (tmp_path / "groundtruth.txt").unlink()
    with pytest.raises(FileNotFoundError, match=r"holds none of groundtruth\.txt, .* with eight"):
        read_tum(tmp_path)


def test_the_only_folder_of_pictures_may_have_any_name_and_a_trajectory_may_not(tmp_path):
    (lay(tmp_path) / "rgb").rename(tmp_path / "color")
    write_picture(tmp_path / "depth/1.png")
    assert format_of(tmp_path) == "tum"
    assert {view.image.parent.name for view in open_capture(tmp_path).views} == {"color"}
    (tmp_path / "groundtruth.txt").rename(tmp_path / "gt.txt")
    with pytest.raises(CaptureError, match="gt.txt has eight .* It needs the name groundtruth.txt"):
        open_capture(tmp_path)
    write_picture(tmp_path / "right/1.png")
    with pytest.raises(CaptureError, match="needs the name groundtruth.txt and pictures in rgb/"):
        open_capture(tmp_path)


def lay_with_kitti(folder, pictures):
    """A capture of TUM's, beside its trajectory in the form of KITTI's."""
    (lay(folder) / "rgb").rename(folder / pictures)
    rows = 3 * ["1 0 0 0 0 1 0 0 0 0 1 0"]
    (folder / "exported.txt").write_text("\n".join(rows))
    return folder


@pytest.mark.parametrize("pictures", ["rgb", "cam", "images"])
def test_a_trajectory_in_kittis_form_beside_it_changes_nothing(tmp_path, pictures):
    lay_with_kitti(tmp_path, pictures)
    assert format_of(tmp_path) == "tum"
    check_pixels(open_capture(tmp_path).views[1])


def test_of_projections_and_a_lens_of_its_own_the_latter_is_read(tmp_path):
    lay_with_kitti(tmp_path, "images")
    (tmp_path / "calib.txt").write_text("P0: 70 0 31.5 0 0 72 23.5 0 0 0 1 0\n")
    # Without a lens that it reads, the pictures are KITTI's.
    assert format_of(tmp_path) == "kitti"
    (tmp_path / "camera-intrinsics.txt").write_text("50 0 31.5\n0 52 23.5\n0 0 1\n")
    assert format_of(tmp_path) == "tum"
    check_pixels(open_capture(tmp_path).views[1])
    (tmp_path / "images").rename(tmp_path / "image_2")
    assert format_of(tmp_path) == "kitti"


def test_of_a_list_that_is_none_the_lines_are_asked_for_and_not_the_pictures(tmp_path):
    (lay(tmp_path) / "rgb.txt").write_text("timestamp filename\n")
    assert tum_near_miss(tmp_path) == (
        "groundtruth.txt has eight numbers a line, as trajectories of TUM have. It needs a "
        "timestamp and a picture on each line of rgb.txt, or no such file."
    )


def test_the_folder_around_has_no_say_about_the_lens(tmp_path):
    lay(tmp_path / "own")
    (tmp_path / "camera-intrinsics.txt").write_text("999 0 31.5\n0 999 23.5\n0 0 1\n")
    assert float(open_capture(tmp_path / "own").views[0].camera.lens.focal[0]) == 50


def test_a_list_may_be_separated_by_tabs(tmp_path):
    lay(tmp_path)
    (tmp_path / "rgb.txt").write_text("".join(f"{s}\trgb/{s}.png\n" for s in STAMPS))
    assert [view.time for view in open_capture(tmp_path).views] == [1, 1.033, 1.066]


@pytest.mark.parametrize("unit", [1e9, 1e6])
def test_stamps_since_1970_are_in_nanoseconds_or_microseconds(unit):
    times = np.array([1.7e9, 1.7e9 + 2.5]) * unit
    np.testing.assert_allclose(in_seconds(times), [1.7e9, 1.7e9 + 2.5], rtol=1e-15)
