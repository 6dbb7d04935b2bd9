"""The cameras of an input folder."""

import numpy as np
import pytest
from quads import write_video

from gaussray.capture.errors import CaptureWarning
from gaussray.dataset.images import write_image
from gaussray.prepare.errors import PrepareError
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
    with pytest.raises(PrepareError, match="must be the folder of the videos or pictures"):
        find_sources(tmp_path / "b" / "0.png")


def test_photographs_of_several_sizes_may_be_in_the_only_folder(tmp_path):
    for name, picture in (("0.png", BLACK), ("1.png", BLACK[:16])):
        write_image(tmp_path / "a" / name, picture)
    (tmp_path / "empty").mkdir()
    (source,) = find_sources(tmp_path)
    assert source.sizes == ((48, 32), (48, 16))


@pytest.mark.parametrize("name", ["depths", "Masks", "depth_maps", "seg"])
def test_depth_maps_and_masks_are_no_cameras(tmp_path, name):
    for folder in ("rgb", name):
        write_image(tmp_path / folder / "0.png", BLACK)
    with pytest.warns(CaptureWarning, match=f"{name}: by the name no pictures of a camera"):
        (source,) = find_sources(tmp_path)
    assert source.name == "rgb"


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("names", [("masks",), ("front", "segment_a")])
def test_a_folder_that_is_alone_or_only_begins_like_one_of_masks_is_a_camera(tmp_path, names):
    for folder in names:
        write_image(tmp_path / folder / "0.png", BLACK)
    assert [source.name for source in find_sources(tmp_path)] == list(names)


def test_pictures_beside_cameras_are_told_to_be_unused(tmp_path):
    write_image(tmp_path / "a" / "0.png", BLACK)
    write_image(tmp_path / "1.png", BLACK)
    with pytest.warns(
        CaptureWarning, match=r"1 pictures beside 1 cameras \(a \.\.\.\) are not used"
    ):
        (source,) = find_sources(tmp_path)
    assert source.name == "a" and source.count == 1


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


def test_two_cameras_of_one_name_are_refused(tmp_path):
    write_video(tmp_path / "a.mp4", [BLACK] * 3)
    write_video(tmp_path / "a.mkv", [BLACK] * 3)
    with pytest.raises(PrepareError, match="got a twice"):
        find_sources(tmp_path)
