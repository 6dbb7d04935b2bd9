"""Masks of photographs: found by their names, upright, in the capture and for COLMAP."""

import numpy as np
import pytest
from PIL import Image
from quads import write_video

from gaussray.capture.errors import CaptureWarning
from gaussray.capture.frames import visible_pixels
from gaussray.capture.open import open_capture
from gaussray.dataset.images import write_image
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.mask_names import marked_masks, mask_of
from gaussray.prepare.masks import copy_masks, written_mask
from gaussray.prepare.media import copy_media
from gaussray.prepare.options import FramesOptions, SyncOptions
from gaussray.prepare.sources import find_sources
from gaussray.prepare.sync import synchronise
from gaussray.prepare.timeline import common_timeline
from gaussray.prepare.video_masks import find_video_masks


BLACK = np.zeros((32, 48, 3), np.uint8)
# EXIF: the top of the scene is at the right of the file.
ACROSS = 6


def half_white(shape=BLACK.shape):
    mask = np.zeros(shape, np.uint8)
    mask[: shape[0] // 2] = 255
    return mask


def copied(folder, out, needed=False):
    """What `prepare` does with an input folder before it looks for poses."""
    sources = find_sources(folder)
    timeline = common_timeline(sources, synchronise(sources, SyncOptions()), FramesOptions())
    video_masks = find_video_masks(sources, out)
    files = copy_media(sources, timeline, out)
    copy_masks(sources, timeline, files, video_masks, out, needed=needed)
    return [path for name in files for path in files[name]]


@pytest.mark.parametrize(
    ("picture", "mask", "alone"),
    [
        ("images/a.jpg", "masks/a.png", True),
        ("images/a.jpg", "masks/a.jpg.png", True),
        ("images/a.JPG", "mask/a.jpg", True),
        ("cam1/a.png", "masks/cam1/a.png", False),
        ("images/cam1/a.png", "masks/cam1/a.jpeg", False),
        ("images/a.jpg", "masks/a_mask.jpg", True),
        ("images/A.JPG", "masks/a.Mask.PNG", True),
        ("images/a.jpg", "mask/a.jpg_MASK.png", True),
        ("cam1/a.png", "masks/cam1/a_mask.png", False),
    ],
)
def test_the_name_of_a_picture_is_that_of_its_mask(tmp_path, picture, mask, alone):
    (tmp_path / mask).parent.mkdir(parents=True)
    (tmp_path / mask).touch()
    assert mask_of(tmp_path / picture, alone=alone) == tmp_path / mask


def test_a_mask_without_a_camera_is_that_of_none_of_several(tmp_path):
    (tmp_path / "masks").mkdir()
    (tmp_path / "masks/a.png").touch()
    assert mask_of(tmp_path / "cam1/a.png", alone=False) is None


@pytest.mark.filterwarnings("ignore:.*by the name no pictures")
def test_masks_are_written_beside_the_pictures_as_they_stand(tmp_path, capsys):
    folder, out = tmp_path / "in", tmp_path / "out"
    write_image(folder / "images/a.png", BLACK)
    write_image(folder / "images/b.png", BLACK)
    write_image(folder / "masks/a.png", half_white())
    turned = Image.fromarray(BLACK)
    exif = turned.getexif()
    exif[0x0112] = ACROSS
    turned.save(folder / "images/c.jpg", exif=exif)
    # As the file lies, whose upper half is then the right one.
    Image.fromarray(half_white()).save(folder / "masks/c.jpg")
    pictures = copied(folder, out)
    assert "2 of 3 pictures have a mask" in capsys.readouterr().out
    masks = [written_mask(path) for path in pictures]
    assert [mask.is_file() for mask in masks] == [True, False, True]
    across = np.asarray(Image.open(masks[2]))[..., 0]
    assert across.shape == (48, 32) and not across[:, :15].any() and across[:, 17:].all()
    # The same input without masks leaves none of them.
    for path in (folder / "masks").iterdir():
        path.unlink()
    copied(folder, out)
    assert not any(mask.exists() for mask in masks)


@pytest.mark.filterwarnings("ignore:.*by the name no pictures")
def test_a_mask_of_another_size_is_told(tmp_path):
    write_image(tmp_path / "in/images/a.png", BLACK)
    write_image(tmp_path / "in/masks/a.png", half_white((16, 16, 3)))
    with pytest.warns(CaptureWarning, match="1 masks, first .*a.png, have another size"):
        copied(tmp_path / "in", tmp_path / "out")


@pytest.mark.parametrize("sizes", [BLACK.shape, (16, 16, 3)])
@pytest.mark.filterwarnings("ignore:.*by the name no pictures", "ignore:.*have another size")
def test_masks_that_are_needed_and_not_there_are_refused_with_a_name(tmp_path, sizes):
    folder = tmp_path / "in/images"
    write_image(folder / "a.png", BLACK)
    if sizes != BLACK.shape:
        write_image(tmp_path / "in/masks/a.png", half_white(sizes))
    with pytest.raises(PrepareError) as refused:
        copied(tmp_path / "in", tmp_path / "out", needed=True)
    assert f"The mask of {folder}/a.png would be {tmp_path}/in/masks/a.png." in str(refused.value)


@pytest.mark.parametrize("cameras", [["images"], ["cam1", "cam2"]])
@pytest.mark.filterwarnings("ignore:.*by the name no pictures")
def test_a_folder_of_masks_of_other_names_is_told_once(tmp_path, cameras):
    for camera in cameras:
        write_image(tmp_path / f"in/{camera}/a.png", BLACK)
        write_image(tmp_path / f"in/{camera}/b.png", BLACK)
    write_image(tmp_path / "in/masks/m1.png", half_white())
    expected = "masks/a.png" if len(cameras) == 1 else "masks/cam1/a.png"
    with pytest.warns(CaptureWarning, match="in 1 file, such as m1.png") as told:
        copied(tmp_path / "in", tmp_path / "out")
    (one,) = (str(w.message) for w in told if "no mask is used" in str(w.message))
    assert one.endswith(f"a.png would be {tmp_path}/in/{expected}.")


@pytest.mark.filterwarnings("ignore:.*by the name no pictures", "ignore:.*taken as static")
def test_the_capture_names_its_masks(tmp_path, painted):
    pytest.importorskip("pycolmap")
    from quads import arc, picture

    from gaussray.prepare.options import PosesOptions, PrepareOptions
    from gaussray.prepare.pipeline import prepare_capture

    for k, camera in enumerate(arc(8)):
        level = picture(camera, painted)
        write_image(tmp_path / f"in/images/{k}.png", level)
        mask = np.full_like(level, 255)
        mask[:, : level.shape[1] // 4] = 0
        if k:
            write_image(tmp_path / f"in/masks/{k}.png", mask)
    options = PrepareOptions(poses=PosesOptions(model="pinhole", masks=True))
    facts = prepare_capture(tmp_path / "in", tmp_path / "out", options=options)
    views = open_capture(tmp_path / "out").views
    assert len(views) == 8 and facts
    assert [view.mask is None for view in views] == [True, *[False] * 7]
    for view in views[1:]:
        shown = visible_pixels(view)
        quarter = shown.shape[1] // 4
        assert not shown[:, :quarter].any() and shown[:, quarter:].all()


def test_of_two_masks_of_one_picture_a_png_counts(tmp_path):
    for name in ("a_masks.jpg", "a_mask.png"):
        write_image(tmp_path / "x" / f"{name}.png", np.full((2, 2, 3), 255, np.uint8))
        (tmp_path / "x" / f"{name}.png").rename(tmp_path / "x" / name)
    assert marked_masks(tmp_path / "x") == {"a": tmp_path / "x" / "a_mask.png"}


@pytest.mark.filterwarnings("error")
def test_folders_of_masks_without_masks_are_no_reason_to_warn(tmp_path):
    (tmp_path / "in/masks/other").mkdir(parents=True)
    for name in "ab":
        write_video(tmp_path / "in" / f"{name}.mp4", [BLACK] * 3)
    write_image(tmp_path / "in/masks/other/0.png", half_white())
    copied(tmp_path / "in", tmp_path / "out")
