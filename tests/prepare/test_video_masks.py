"""Masks of videos: found by their names, one for each frame, in the capture and for its views."""

import json

import numpy as np
import pytest
from PIL import Image
from quads import RATE, write_video

from gaussray.capture.errors import CaptureWarning
from gaussray.capture.frames import visible_pixels
from gaussray.capture.open import open_capture
from gaussray.dataset.images import write_image
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.masks import copy_masks, written_mask
from gaussray.prepare.media import copy_media
from gaussray.prepare.options import FramesOptions, SyncOptions
from gaussray.prepare.sources import find_sources
from gaussray.prepare.sync import synchronise
from gaussray.prepare.timeline import common_timeline
from gaussray.prepare.video_masks import find_video_masks


HEIGHT, WIDTH, COUNT = 32, 48, 6
BLACK = np.zeros((HEIGHT, WIDTH, 3), np.uint8)


def masks(count=COUNT, height=HEIGHT):
    """White columns, one of eight more in each mask."""
    result = []
    for k in range(count):
        mask = np.zeros((height, WIDTH, 3), np.uint8)
        mask[:, : 8 * k] = 255
        result.append(mask)
    return result


def write_masks(path, levels):
    """A video of masks, or a folder of numbered pictures."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix:
        write_video(path, levels)
        return
    for k, mask in enumerate(levels):
        write_image(path / f"{k:03d}.png", mask)


def write_videos(folder, names=("cam0", "cam1"), count=COUNT):
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        (folder / name).parent.mkdir(exist_ok=True)
        write_video(folder / f"{name}.mp4", [BLACK] * count)


def copied(folder, out, needed=False, rate=0.0):
    """What `prepare` does with an input folder before it looks for poses."""
    sources = find_sources(folder)
    options = FramesOptions(rate=rate)
    timeline = common_timeline(sources, synchronise(sources, SyncOptions()), options)
    video_masks = find_video_masks(sources, out)
    files = copy_media(sources, timeline, out)
    copy_masks(sources, timeline, files, video_masks, out, needed=needed)
    return files


def white_columns(files):
    """How many columns of the mask of each frame are white; None of one without."""
    result = []
    for path in files:
        mask = written_mask(path)
        if mask.is_file():
            levels = np.asarray(Image.open(mask).convert("RGB"))
            assert levels.shape == BLACK.shape and set(np.unique(levels)) <= {0, 255}
            assert (levels == levels[:1, :, :1]).all()
            result.append(int((levels[0, :, 0] == 255).sum()))
        else:
            result.append(None)
    return result


EACH = [8 * k for k in range(COUNT)]
OTHER_FOLDER = "ignore:.*by the name no pictures of a camera"


@pytest.mark.parametrize(
    "where",
    [
        "masks/cam0.mp4",
        "mask/cam0.MOV",
        "masks/cam0",
        "cam0_mask.mp4",
        "masks/cam0_mask.mp4",
        "cam0.masks.mkv",
        "../masks/cam0",
        "../masks/cam0.mp4",
    ],
)
@pytest.mark.filterwarnings(OTHER_FOLDER)
def test_masks_are_found_by_their_name(tmp_path, capsys, where):
    folder = tmp_path / "in/videos"
    write_videos(folder)
    write_masks(folder / where, masks())
    files = copied(folder, tmp_path / "out")
    assert list(files) == ["cam0", "cam1"]
    assert white_columns(files["cam0"]) == EACH
    assert white_columns(files["cam1"]) == [None] * COUNT
    assert written_mask(files["cam0"][3]) == tmp_path / "out/masks/cam0/0003.png"
    told = f"{COUNT} of {2 * COUNT} pictures have a mask, whose white pixels count in the fit."
    assert told in capsys.readouterr().out


@pytest.mark.parametrize("where", ["cam1/masks", "cam1/a_mask.mp4", "masks/cam1.mp4", "masks/cam1"])
@pytest.mark.filterwarnings(OTHER_FOLDER)
def test_the_video_may_lie_in_the_folder_of_its_camera(tmp_path, where):
    write_videos(tmp_path / "in", ("cam0/a", "cam1/a"))
    write_masks(tmp_path / "in" / where, masks())
    files = copied(tmp_path / "in", tmp_path / "out")
    assert white_columns(files["cam1"]) == EACH and set(white_columns(files["cam0"])) == {None}


@pytest.mark.filterwarnings(OTHER_FOLDER)
def test_masks_of_the_frames_that_are_used_are_written(tmp_path):
    write_videos(tmp_path / "in")
    for name in ("cam0.mp4", "cam1"):
        write_masks(tmp_path / "in/masks" / name, masks())
    files = copied(tmp_path / "in", tmp_path / "out", needed=True, rate=RATE / 2)
    assert [path.name for path in files["cam0"]] == ["0000", "0002", "0004"]
    for name in files:
        assert white_columns(files[name]) == EACH[::2]
        assert len(list((tmp_path / "out/masks" / name).iterdir())) == 3
    # The same input without masks leaves none of them.
    for path in sorted((tmp_path / "in/masks").rglob("*.*")):
        path.unlink()
    files = copied(tmp_path / "in", tmp_path / "out", rate=RATE / 2)
    assert {one for own in files.values() for one in white_columns(own)} == {None}


@pytest.mark.filterwarnings(OTHER_FOLDER)
def test_a_single_video_has_the_masks_beside_it(tmp_path):
    write_videos(tmp_path / "in", ("clip",))
    write_masks(tmp_path / "in/masks", masks())
    for videos in (tmp_path / "in", tmp_path / "in/clip.mp4"):
        assert white_columns(copied(videos, tmp_path / "out")["clip"]) == EACH


@pytest.mark.parametrize("where", ["masks/cam0.mp4", "masks/cam0"])
@pytest.mark.parametrize(
    ("levels", "message"),
    [
        (masks(COUNT - 1), "must be one for each of its 6 frames, got 5. Write them anew, or take"),
        (masks(COUNT + 1), "must be one for each of its 6 frames, got 7. Write them anew, or take"),
        (masks(height=16), "must be one of 48 x 32, got 48 x 16. Write them anew, or take them"),
    ],
)
@pytest.mark.filterwarnings(OTHER_FOLDER)
def test_masks_that_do_not_fit_are_refused(tmp_path, where, levels, message):
    write_videos(tmp_path / "in")
    write_masks(tmp_path / "in" / where, levels)
    with pytest.raises(PrepareError, match=f"{where}: the masks of .*cam0.mp4 {message}"):
        copied(tmp_path / "in", tmp_path / "out")


@pytest.mark.filterwarnings(OTHER_FOLDER)
def test_two_masks_of_one_video_are_refused(tmp_path):
    write_videos(tmp_path / "in")
    for where in ("masks/cam0.mp4", "masks/cam0"):
        write_masks(tmp_path / "in" / where, masks())
    with pytest.raises(PrepareError, match="must have one video or folder of masks, got .*cam0"):
        copied(tmp_path / "in", tmp_path / "out")


def test_masks_that_are_needed_and_not_there_are_refused_with_a_name(tmp_path):
    write_videos(tmp_path / "in")
    with pytest.raises(PrepareError, match="needs masks .* would be .*masks/cam0.mp4 .as many fra"):
        copied(tmp_path / "in", tmp_path / "out", needed=True)


@pytest.mark.filterwarnings(OTHER_FOLDER)
def test_a_video_of_masks_of_another_name_is_told(tmp_path):
    write_videos(tmp_path / "in")
    write_masks(tmp_path / "in/masks/left.mp4", masks())
    with pytest.warns(CaptureWarning, match="no video has the name of left.mp4, so no"):
        copied(tmp_path / "in", tmp_path / "out")


@pytest.mark.filterwarnings(OTHER_FOLDER)
def test_a_capture_with_such_masks_hides_what_is_black(tmp_path):
    write_videos(tmp_path / "in")
    for name in ("cam0", "cam1"):
        write_masks(tmp_path / "in/masks" / f"{name}.mp4", masks())
    out = tmp_path / "out"
    files = copied(tmp_path / "in", out)
    lens = {"fl_x": 40.0, "fl_y": 40.0, "cx": 24.0, "cy": 16.0, "w": WIDTH, "h": HEIGHT}
    frames = [
        {
            "file_path": path.relative_to(out).as_posix(),
            "mask_path": written_mask(path).relative_to(out).as_posix(),
            **{"camera": name, "time": k / 30, "split": "train"},
            "transform_matrix": np.eye(4).tolist(),
        }
        for name, own in files.items()
        for k, path in enumerate(own)
    ]
    content = {**lens, "camera_model": "OPENCV", "time_unit": "seconds", "frames": frames}
    (out / "transforms.json").write_text(json.dumps(content))
    views = open_capture(out).views
    assert len(views) == 2 * COUNT
    for k, view in enumerate(views):
        shown = visible_pixels(view)
        assert shown[:, : EACH[k % COUNT]].all() and not shown[:, EACH[k % COUNT] :].any()


@pytest.mark.filterwarnings(OTHER_FOLDER)
def test_prepare_seeks_features_in_what_is_white(tmp_path, painted):
    pytest.importorskip("pycolmap")
    from quads import arc, picture

    from gaussray.prepare.options import PosesOptions, PrepareOptions
    from gaussray.prepare.pipeline import prepare_capture

    (tmp_path / "in").mkdir()
    for k, camera in enumerate(arc(8)):
        level = picture(camera, painted)
        mask = np.full_like(level, 255)
        mask[:, : level.shape[1] // 4] = 0
        write_video(tmp_path / f"in/cam{k}.mp4", [level] * 3)
        write_masks(tmp_path / f"in/masks/cam{k}.mp4", [mask] * 3)
    options = PrepareOptions(
        sync=SyncOptions(method="none"), poses=PosesOptions(model="pinhole", masks=True)
    )
    prepare_capture(tmp_path / "in", tmp_path / "out", options=options)
    views = open_capture(tmp_path / "out").views
    assert len(views) == 24
    for view in views:
        shown = visible_pixels(view)
        quarter = shown.shape[1] // 4
        assert not shown[:, : quarter - 1].any() and shown[:, quarter + 1 :].all()


def kept_bytes(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.filterwarnings(OTHER_FOLDER)
def test_masks_in_the_folder_that_is_written_are_refused_and_kept(tmp_path):
    write_videos(tmp_path / "videos")
    write_masks(tmp_path / "masks/cam0", masks())
    before = kept_bytes(tmp_path)
    sources = find_sources(tmp_path / "videos")
    with pytest.raises(PrepareError, match="masks/cam0: the masks of .*cam0.mp4 must not lie in"):
        find_video_masks(sources, tmp_path)
    assert kept_bytes(tmp_path) == before
    assert find_video_masks(sources, tmp_path / "out") == {
        "cam0": tmp_path / "masks/cam0",
        "cam1": None,
    }


@pytest.mark.filterwarnings(OTHER_FOLDER)
def test_nothing_is_lost_where_masks_do_not_fit(tmp_path):
    write_videos(tmp_path / "in")
    write_masks(tmp_path / "in/masks/cam0.mp4", masks())
    assert white_columns(copied(tmp_path / "in", tmp_path / "out")["cam0"]) == EACH
    mine = tmp_path / "out/masks/cam1/0002.png"
    write_image(mine, masks()[5])
    before = mine.read_bytes()
    write_masks(tmp_path / "in/masks/cam1.mp4", masks())
    with pytest.raises(PrepareError, match="0002.png: is a mask that no earlier run is known to"):
        copied(tmp_path / "in", tmp_path / "out")
    assert mine.read_bytes() == before
    (tmp_path / "in/masks/cam1.mp4").unlink()
    files = copied(tmp_path / "in", tmp_path / "out")
    assert mine.read_bytes() == before and white_columns(files["cam0"]) == EACH
    assert white_columns(files["cam1"]) == [None, None, 40, None, None, None]


@pytest.mark.filterwarnings(OTHER_FOLDER)
def test_a_second_run_into_the_folder_above_finds_the_same_masks(tmp_path):
    write_videos(tmp_path / "videos")
    write_masks(tmp_path / "masks/cam0.mp4", masks())
    for _ in range(2):
        assert white_columns(copied(tmp_path / "videos", tmp_path)["cam0"]) == EACH
    (tmp_path / "masks/cam0.mp4").unlink()
    assert white_columns(copied(tmp_path / "videos", tmp_path)["cam0"]) == [None] * COUNT


@pytest.mark.filterwarnings(OTHER_FOLDER)
def test_masks_one_further_up_have_the_name_of_the_camera(tmp_path):
    write_videos(tmp_path / "in", ("cam01/video", "cam02/video"))
    write_masks(tmp_path / "in/masks/video.mp4", masks())
    files = copied(tmp_path / "in", tmp_path / "out")
    assert {one for own in files.values() for one in white_columns(own)} == {None}
    write_masks(tmp_path / "in/cam01/masks/video.mp4", masks())
    files = copied(tmp_path / "in", tmp_path / "out")
    assert white_columns(files["cam01"]) == EACH and set(white_columns(files["cam02"])) == {None}
