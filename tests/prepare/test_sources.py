"""The cameras of an input folder."""

import dataclasses
from pathlib import Path
from time import process_time

import numpy as np
import pytest
from quads import write_video

from gaussray.capture.errors import CaptureWarning
from gaussray.capture.side_folders import are_other_maps
from gaussray.dataset.images import write_image
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.mask_names import mask_of
from gaussray.prepare.motion import motion_energy
from gaussray.prepare.names_of_cameras import camera_in_name, pictures_by_camera
from gaussray.prepare.sources import find_sources


BLACK = np.zeros((32, 48, 3), np.uint8)


def test_videos_and_folders_are_cameras_in_natural_order(tmp_path):
    for name in ("cam10", "cam2"):
        write_video(tmp_path / f"{name}.mp4", [BLACK] * 4, rate=25)
    for i in (10, 9):
        write_image(tmp_path / "cam3" / f"{i}.png", BLACK)
    write_video(tmp_path / "inner.mp4", [BLACK] * 4)
    (tmp_path / "cam4").mkdir()
    (tmp_path / "inner.mp4").rename(tmp_path / "cam4" / "clip.mp4")
    sources = find_sources(tmp_path)
    assert [source.name for source in sources] == ["cam2", "cam3", "cam4", "cam10"]
    assert [path.stem for path in sources[1].pictures] == ["9", "10"]
    assert sources[0].rate == pytest.approx(25) and sources[0].is_even
    assert (sources[0].width, sources[0].height, sources[0].count) == (48, 32, 4)
    assert not sources[0].has_sound and sources[2].is_video


def test_a_folder_of_pictures_is_one_camera(tmp_path):
    for i in range(3):
        write_image(tmp_path / f"{i}.png", BLACK)
    (source,) = find_sources(tmp_path)
    assert source.name == tmp_path.name and source.count == 3 and source.rate == 0


def test_what_is_no_input_is_refused_with_a_remedy(tmp_path):
    with pytest.raises(FileNotFoundError, match="does not exist"):
        find_sources(tmp_path / "nowhere")
    with pytest.raises(PrepareError, match="must hold a video"):
        find_sources(tmp_path)
    write_image(tmp_path / "a" / "0.png", BLACK)
    write_image(tmp_path / "a" / "1.png", BLACK[:16])
    write_image(tmp_path / "b" / "0.png", BLACK)
    with pytest.raises(PrepareError, match="must have one size"):
        find_sources(tmp_path)
    with pytest.raises(PrepareError, match="must be a video or the folder of the videos"):
        find_sources(tmp_path / "b" / "0.png")


def test_photographs_of_several_sizes_may_be_in_the_only_folder(tmp_path):
    for name, picture in (("0.png", BLACK), ("1.png", BLACK[:16])):
        write_image(tmp_path / "a" / name, picture)
    (tmp_path / "empty").mkdir()
    (source,) = find_sources(tmp_path)
    assert source.sizes == ((48, 32), (48, 16))


def test_a_video_is_the_one_camera_of_its_folder(tmp_path):
    for name in ("a", "b"):
        write_video(tmp_path / f"{name}.mp4", [BLACK] * 3)
    (source,) = find_sources(tmp_path / "a.mp4")
    assert source.name == "a" and source.is_video and source.count == 3


def test_an_empty_video_is_called_empty(tmp_path):
    (tmp_path / "a.mp4").write_bytes(b"")
    with pytest.raises(PrepareError, match="a.mp4: the video is an empty file"):
        find_sources(tmp_path)


@pytest.mark.parametrize(
    "name",
    [
        *("depths", "Masks", "depth_maps", "seg", "instances", "disp"),
        *("Calibration", "chessboard_1", "intrinsics", "calib2", "calibration_images"),
    ],
)
def test_depth_maps_and_masks_are_no_cameras(tmp_path, name):
    for folder in ("rgb", name):
        write_image(tmp_path / folder / "0.png", BLACK)
    with pytest.warns(CaptureWarning, match=f"{name}: by the name no pictures of a camera"):
        (source,) = find_sources(tmp_path)
    assert source.name == "rgb"


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "names",
    [
        ("masks",),
        ("front", "segment_a"),
        ("calib_cam1", "calib_cam2"),
        ("extrinsic_test_cam1", "instance_a"),
    ],
)
def test_a_folder_that_is_alone_or_only_begins_like_one_of_masks_is_a_camera(tmp_path, names):
    for folder in names:
        write_image(tmp_path / folder / "0.png", BLACK)
    assert [source.name for source in find_sources(tmp_path)] == list(names)


def test_pictures_beside_cameras_are_told_to_be_unused(tmp_path):
    write_image(tmp_path / "a" / "0.png", BLACK)
    write_image(tmp_path / "1.png", BLACK)
    with pytest.warns(CaptureWarning, match=r"1 picture beside 1 camera \(a\) is not used"):
        (source,) = find_sources(tmp_path)
    assert source.name == "a" and source.count == 1


def test_depth_maps_and_masks_within_the_photographs_folder_do_not_replace_them(tmp_path):
    for k in range(3):
        write_image(tmp_path / f"img{k}.png", BLACK)
        write_image(tmp_path / "depth" / f"img{k}_disp.png", BLACK)
        write_image(tmp_path / "masks" / f"img{k}.png", BLACK)
    with pytest.warns(CaptureWarning, match="depth, masks: by the name no pictures of a camera"):
        (source,) = find_sources(tmp_path)
    assert [path.name for path in source.pictures] == ["img0.png", "img1.png", "img2.png"]
    assert mask_of(source.pictures[1], alone=True) == tmp_path / "masks" / "img1.png"


@pytest.mark.parametrize(
    ("picture", "others"),
    [
        ("frame-{:06d}.color", ["frame-{:06d}.depth"]),
        ("{:04d}", ["{:04d}_mask", "{:04d}_normals", "{:04d} Confidence"]),
        ("rgb{}", ["depth{}"]),
        ("IMG_{}", ["IMG_{}_normal"]),
        ("image_{}", ["depth-{}", "mask_{}"]),
    ],
)
def test_depth_maps_and_masks_beside_photographs_are_left_out(tmp_path, picture, others):
    for k in range(3):
        for name in (picture, *others):
            write_image(tmp_path / f"{name.format(k)}.png", BLACK)
    count = 3 * len(others)
    with pytest.warns(CaptureWarning, match=f"{count} of {count + 3} files .* by their names no"):
        (source,) = find_sources(tmp_path)
    assert [path.stem for path in source.pictures] == [picture.format(k) for k in range(3)]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "names",
    [
        ["mask_1", "mask_2"],
        ["depth_1", "depth_2", "cover"],
        ["segment_1", "unmasked", "c"],
        ["IMG_0_under", "IMG_0_normal", "IMG_0_over", "IMG_1_under", "IMG_1_normal", "IMG_1_over"],
        ["label_01", "gas_mask_001", "instance-1", "disp_3", "depth_of_field_1", "a", "b", "c"],
    ],
)
def test_photographs_of_masks_are_photographs(tmp_path, names):
    for name in names:
        write_image(tmp_path / f"{name}.png", BLACK)
    (source,) = find_sources(tmp_path)
    assert source.count == len(names)


def test_depth_maps_of_many_photographs_are_told_in_a_moment(tmp_path):
    names = [f"{k:05d}{word}.png" for k in range(6000) for word in ("", "_depth")]
    start = process_time()
    assert are_other_maps([tmp_path / name for name in names]) == [False, True] * 6000
    assert process_time() - start < 3


def test_folders_of_very_different_numbers_of_pictures_are_told(tmp_path):
    for name, count in (("a", 4), ("b", 3), ("boards", 2)):
        for k in range(count):
            write_image(tmp_path / name / f"{k}.png", BLACK)
    with pytest.warns(CaptureWarning, match="a has 4 pictures and boards 2: .* at most 2 of each"):
        find_sources(tmp_path)


def test_of_photographs_and_a_subfolder_the_larger_set_is_used(tmp_path):
    for k in range(4):
        write_image(tmp_path / f"{k}.png", BLACK)
    for k in range(2):
        write_image(tmp_path / "board" / f"{k}.png", BLACK)
    with pytest.warns(CaptureWarning, match="the 4 pictures .* not the 2 in its folder board. If"):
        (source,) = find_sources(tmp_path)
    assert source.name == tmp_path.name and source.count == 4
    for k in range(2, 5):
        write_image(tmp_path / "board" / f"{k}.png", BLACK)
    with pytest.warns(CaptureWarning, match=r"4 pictures beside 1 camera \(board\) are not used"):
        (source,) = find_sources(tmp_path)
    assert source.name == "board" and source.count == 5


@pytest.mark.parametrize("place", ["", "images"])
def test_pictures_named_by_camera_and_time_are_those_cameras(tmp_path, capsys, place):
    for camera in range(3):
        for time in (0, 8, 16):
            write_image(tmp_path / place / f"cam_{camera}_img_{time:04d}.png", BLACK)
    sources = find_sources(tmp_path)
    assert [source.name for source in sources] == ["cam_0", "cam_1", "cam_2"]
    assert [path.name for path in sources[1].pictures] == [
        *("cam_1_img_0000.png", "cam_1_img_0008.png", "cam_1_img_0016.png"),
    ]
    said = capsys.readouterr().out
    assert "of 3 cameras (cam_0, cam_1, cam_2) at 3 times. If" in said and said.count("\n") == 1


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "names",
    [
        [f"IMG_{k:04d}" for k in range(8)],
        [f"DSC000{k}_{i}" for k in range(4) for i in range(3)],
        [f"20240212_{k}" for k in (100101, 100102, 110101, 110102)],
        [f"CAM0000{k}_{i}" for k in range(3) for i in range(2)],
        [f"{letter}_{k}" for letter in "ab" for k in range(3)],
        [f"camera_{k}" for k in range(6)],
        [f"cam_{k}_0001" for k in range(6)],
        ["front_1", "front_2", "back_7", "back_8"],
    ],
)
def test_ordinary_photographs_are_of_one_camera(tmp_path, names):
    for name in names:
        (tmp_path / f"{name}.png").write_bytes(b"")
    assert pictures_by_camera(sorted(tmp_path.iterdir())) is None


def test_pictures_of_cameras_at_times_that_do_not_agree_are_doubtful(tmp_path):
    for name in ("cam1_10", "cam1_20", "cam2_11", "cam2_21"):
        write_image(tmp_path / f"{name}.png", BLACK)
    with pytest.warns(CaptureWarning, match=r"2 cameras \(cam1, cam2\).*into a folder of its own"):
        (source,) = find_sources(tmp_path)
    assert source.count == 4


def test_words_for_sides_are_doubtful_and_missing_times_are_left_out():
    sides = [Path(f"{side}_{k}.png") for side in ("front", "back") for k in range(3)]
    found = pictures_by_camera(sides)
    assert found is not None and not found.together and list(found.cameras) == ["front", "back"]
    shots = [Path(f"Camera{c}.{k:05d}.tif") for c in (1, 2, 3) for k in range(9)]
    found = pictures_by_camera(shots[:-1])
    assert found is not None and found.together
    assert [len(own) for own in found.cameras.values()] == [8, 8, 8]
    assert camera_in_name("left_0007") == "left" and camera_in_name("leftover_7") == ""
    for word, cameras in (("img", True), ("house", False)):
        pairs = [Path(f"{word}_{side}_{k}.png") for side in ("left", "right") for k in range(3)]
        found = pictures_by_camera(pairs)
        assert found is not None and found.together == cameras


def test_files_of_formats_that_are_not_read_are_told(tmp_path):
    write_image(tmp_path / "in" / "a.png", np.zeros((8, 8, 3), np.uint8))
    for name in ("a.dng", "b.CR2", "c.insv"):
        (tmp_path / "in" / name).write_bytes(b"")
    # Raw data beside a picture of the same name are meant to be left out.
    with pytest.warns(
        CaptureWarning, match=r"2 files of formats .* \(b.CR2, c.insv\) are left out"
    ):
        (source,) = find_sources(tmp_path / "in")
    assert source.count == 1
    (tmp_path / "in" / "a.png").unlink()
    with pytest.raises(PrepareError, match="got a.dng, b.CR2, c.insv. Convert them."):
        find_sources(tmp_path / "in")


def test_a_folder_of_videos_that_lies_deeper_is_named(tmp_path):
    write_image(tmp_path / "one" / "two" / "a.png", np.zeros((8, 8, 3), np.uint8))
    with pytest.raises(PrepareError, match="got none. Did you mean videos=.*two?"):
        find_sources(tmp_path)


def test_folders_of_folders_beside_cameras_are_told(tmp_path, capsys):
    for name in ("left", "right", "rectified/left", "other/a/b", "masks/left", ".hidden/left"):
        write_image(tmp_path / name / "0.png", BLACK)
    (tmp_path / "notes").mkdir()
    assert [source.name for source in find_sources(tmp_path)] == ["left", "right"]
    (line,) = capsys.readouterr().out.splitlines()
    assert line.startswith(f"videos={tmp_path}: 2 folders (other, rectified) are not used")
    assert line.endswith(f"videos={tmp_path}/other.")


def test_two_cameras_of_one_name_are_refused(tmp_path):
    write_video(tmp_path / "a.mp4", [BLACK] * 3)
    write_video(tmp_path / "a.mkv", [BLACK] * 3)
    with pytest.raises(PrepareError, match=r"got a\.mkv and a\.mp4\. Rename one of them"):
        find_sources(tmp_path)


def test_the_frames_of_a_video_beside_it_are_no_other_camera(tmp_path):
    write_video(tmp_path / "a.mp4", [BLACK] * 3)
    write_image(tmp_path / "a" / "0.png", BLACK)
    text = r"got a\.mp4 and the folder a\. If the folder a holds the frames .*, move one"
    with pytest.raises(PrepareError, match=text):
        find_sources(tmp_path)


def test_several_videos_in_a_folder_of_a_camera_are_listed_with_the_choice(tmp_path):
    write_video(tmp_path / "any.mp4", [BLACK] * 3)
    data = (tmp_path / "any.mp4").read_bytes()
    (tmp_path / "any.mp4").unlink()

    def put(*names):
        for name in names:
            (tmp_path / name).parent.mkdir(exist_ok=True)
            (tmp_path / name).write_bytes(data)

    put("c1/video.mp4", "c1/board.mp4")
    with pytest.raises(PrepareError, match=r"board.mp4, video.mp4. If each is a camera, set vid"):
        find_sources(tmp_path)
    put("c2/video.mp4")
    with pytest.raises(PrepareError, match="c1: .*got board.mp4, video.mp4. Leave video.mp4 alone"):
        find_sources(tmp_path)
    put("c2/board.mp4")
    with pytest.raises(PrepareError, match="Leave board.mp4 or video.mp4 alone in each folder"):
        find_sources(tmp_path)
    put("c3/other.mp4")
    with pytest.raises(PrepareError, match="Leave one of them, that shows the scene, in each"):
        find_sources(tmp_path)
    for name in ("c1/board.mp4", "c2/board.mp4"):
        (tmp_path / name).unlink()
    assert [source.name for source in find_sources(tmp_path)] == ["c1", "c2", "c3"]


def test_a_video_with_fewer_pictures_than_times_is_refused_in_words(tmp_path):
    write_video(tmp_path / "a.mp4", [BLACK] * 4)
    (source,) = find_sources(tmp_path)
    longer = dataclasses.replace(source, times=np.arange(5) / 30)
    with pytest.raises(PrepareError, match=r"a.mp4: .* its 5 times, got 4 pictures. Encode it"):
        motion_energy(longer)
