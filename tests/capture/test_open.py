"""What lies in a folder decides who reads it, or one error says what each reader needs."""

import json

import films
import jax.numpy as jnp
import numpy as np
import OpenImageIO as oiio
import pytest

from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.frames import read_encoded
from gaussray.capture.open import FORMAT_FILES, FORMATS, format_of, open_capture
from gaussray.cli.main import main
from gaussray.color import srgb_encode
from gaussray.dataset.images import write_image


# An 8-bit code is rounded to the nearest; a float picture is single precision.
CODE = 0.5
SINGLE = 1e-6
FRAME = {"file_path": "0.png", "transform_matrix": np.eye(4).tolist(), "time": 0.5, "camera": "c"}
PAIRED = {"w": 16, "h": 12, "fl_x": 20, "fl_y": 20, "cx": 8, "cy": 6, "frames": [FRAME]}
SPLIT = {"camera_angle_x": 0.7, "frames": [FRAME]}


@pytest.fixture
def folder(tmp_path):
    """A folder with one picture, for JSON files to be laid beside."""
    write_image(tmp_path / "0.png", np.full((12, 16, 3), 128, np.uint8))
    return tmp_path


def lay(folder, name, content):
    (folder / name).write_text(json.dumps(content))


def test_every_format_has_a_reader_and_says_what_it_needs():
    known = {"paired", "splits", "neural3d", "llff", "dynamic3dgs", "nerfies", "pinf", "colmap"}
    known |= {"metashape", "neus", "immersive", "technicolor", "actorshq"}
    known |= {"alicevision", "opensfm", "openmvg", "bundler", "middlebury", "record3d"}
    known |= {"sevenscenes", "kitti", "tum", "euroc"}
    assert FORMATS.keys() == FORMAT_FILES.keys() == known


def test_the_layout_of_easyvolcap_is_told_the_command_that_reads_it(folder):
    (folder / "intri.yml").write_text("%YAML:1.0\n")
    with pytest.raises(
        CaptureError, match=r"gaussray prepare videos=\S+/images poses.calibration="
    ):
        format_of(folder)


@pytest.mark.parametrize("format", ["auto", "paired"])
def test_transforms_json_is_a_paired_capture(folder, format):
    lay(folder, "transforms.json", {**PAIRED, "split": "test"})
    capture = open_capture(folder, format)
    assert [view.split for view in capture.views] == ["test"]


@pytest.mark.parametrize("format", ["auto", "splits"])
def test_transforms_train_json_is_a_capture_of_splits(folder, format):
    lay(folder, "transforms_train.json", SPLIT)
    (view,) = open_capture(str(folder), format).views
    assert (view.split, view.camera_name, view.width) == ("train", "c", 16)


def test_a_folder_of_effects_alone_is_a_paired_capture(folder):
    lay(folder, "depth_of_field.json", {**PAIRED, "split": "test"})
    lay(folder, "report.json", {"psnr": 30})
    assert list(open_capture(folder).effects) == ["depth_of_field"]


def test_the_type_of_number_is_handed_on(folder):
    lay(folder, "transforms_train.json", SPLIT)
    for kind in (jnp.float32, jnp.float64):
        (view,) = open_capture(folder, dtype=kind).views
        assert view.camera.time.dtype == jnp.dtype(kind)


def test_a_folder_around_a_capture_tells_where_it_is(folder):
    scene = folder / "work" / "data" / "scene"
    scene.mkdir(parents=True)
    lay(scene, "transforms.json", PAIRED)
    with pytest.raises(CaptureError, match="name .*data.scene, which is one"):
        open_capture(folder / "work")
    with pytest.raises(CaptureError, match="holds videos or pictures without poses"):
        format_of(folder)


def test_pictures_that_lie_elsewhere_are_found_for_the_message(folder):
    lost = {**FRAME, "file_path": "images/0.png"}
    lay(folder, "transforms.json", {**PAIRED, "split": "train", "frames": [lost]})
    (folder / "other").mkdir()
    (folder / "other" / "0.png").write_bytes((folder / "0.png").read_bytes())
    with pytest.raises(CaptureError, match=r"A file of this name is .*0\.png\. Copy the pictures"):
        open_capture(folder)


def test_held_out_pictures_that_were_trained_on_are_told(folder):
    for name in ("train", "test"):
        lay(folder, f"transforms_{name}.json", SPLIT)
    with pytest.warns(CaptureWarning, match="1 pictures to score, first 0.png, are training"):
        open_capture(folder)


@pytest.mark.filterwarnings("ignore:.*turns back within the picture")
def test_distortion_may_turn_back_in_the_corners_of_a_picture(folder):
    lens = {"camera_model": "OPENCV", "fl_x": 14, "fl_y": 14, "k1": -0.45}
    lay(folder, "transforms.json", {**PAIRED, "split": "train", **lens})
    with pytest.warns(CaptureWarning, match="about .* % of its pixels, at the corners, have no"):
        (view,) = open_capture(folder).views
    corner, middle = (view.camera.lens.direction(jnp.array(at)) for at in ([0.5, 0.5], [8.0, 6.0]))
    assert not np.any(corner) and np.any(middle)
    lay(folder, "transforms.json", {**PAIRED, "split": "train", **lens, "k1": -1.5})
    with pytest.raises(CaptureError, match="lens.distortion must give every pixel a direction"):
        open_capture(folder)


def test_what_a_capture_was_made_of_may_lie_beside_it(folder):
    """JSON comes before poses with videos, and these before a model of COLMAP."""
    for name in ("cameras", "images"):
        lay(folder, f"{name}.txt", "")
    assert format_of(folder) == "colmap"
    (folder / "poses_bounds.npy").write_bytes(b"")
    assert format_of(folder) == "colmap"
    (folder / "cam00.mp4").write_bytes(b"")
    assert format_of(folder) == "neural3d"
    lay(folder, "fisheye.json", {**PAIRED, "split": "test"})
    assert format_of(folder) == "paired"
    (folder / "fisheye.json").unlink()
    lay(folder, "transforms_train.json", SPLIT)
    assert format_of(folder) == "splits"


def test_splits_are_read_before_the_file_of_all_frames(folder):
    lay(folder, "transforms.json", {**PAIRED, "split": "test"})
    lay(folder, "transforms_train.json", {**SPLIT, "split": "train"})
    with pytest.warns(CaptureWarning, match="of which the latter is read.*capture=paired"):
        assert open_capture(folder).views[0].split == "train"
    assert open_capture(folder, "paired").views[0].split == "test"


@pytest.mark.filterwarnings("ignore:.*is taken as static", "ignore:.*each 8th of 2 is held out")
def test_poses_of_all_pictures_are_read_before_a_model_of_pictures_that_were_renamed(folder):
    (folder / "images").mkdir()
    for shade, name in enumerate(("1.png", "2.png")):
        write_image(folder / "images" / name, np.full((12, 16, 3), shade, np.uint8))
    (folder / "cameras.txt").write_text("1 PINHOLE 16 12 20 20 8 6\n")
    registered = (
        f"{k + 1} 1 0 0 0 {k} 0 0 1 {name}\n\n" for k, name in enumerate(("0.png", "2.png"))
    )
    (folder / "images.txt").write_text("".join(registered))
    row = [0, 1, 0, 0, 12, -1, 0, 0, 1, 16, 0, 0, 1, 0, 20, 1, 9]
    np.save(folder / "poses_bounds.npy", np.array([row, row], float))
    with pytest.warns(CaptureWarning, match="1 pictures of COLMAP's model do not exist.*0.png"):
        capture = open_capture(folder)
    assert [view.image.name for view in capture.views] == ["1.png", "2.png"]
    np.save(folder / "poses_bounds.npy", np.array([row, row, row], float))
    with pytest.warns(CaptureWarning, match="1 of 2 frames have no picture"):
        assert [view.image.name for view in open_capture(folder).views] == ["2.png"]


def test_easymocap_names_the_folder_of_its_cameras(folder):
    (folder / "intri.yml").write_text("")
    (folder / "videos" / "01").mkdir(parents=True)
    with pytest.raises(CaptureError, match=r"prepare videos=.*/videos poses.calibration="):
        open_capture(folder)


def test_a_folder_of_no_format_is_told_what_each_needs(folder):
    lay(folder, "report.json", {"psnr": 30})
    (folder / "0.png").unlink()
    with pytest.raises(CaptureError) as caught:
        open_capture(folder)
    text = str(caught.value)
    assert str(folder) in text
    assert all(f"{name} needs {what}" in text for name, what in FORMAT_FILES.items())


def test_a_test_split_without_its_training_split_is_named(folder):
    lay(folder, "transforms_test.json", SPLIT)
    assert format_of(folder) == "splits"
    with pytest.raises(CaptureError, match="must hold transforms_train.json"):
        open_capture(folder)


def test_a_format_that_there_is_not_lists_those_that_are(folder):
    with pytest.raises(ValueError, match="capture.format .* one of auto, paired, .* got 'ns'"):
        open_capture(folder, "ns")


def test_a_format_that_the_folder_is_not_of_is_its_readers_error(folder):
    lay(folder, "transforms_train.json", SPLIT)
    with pytest.raises(FileNotFoundError, match="must hold cameras and images"):
        open_capture(folder, "colmap")


def test_a_folder_that_is_not_there(tmp_path):
    with pytest.raises(FileNotFoundError, match="none: no such folder. Name a capture"):
        open_capture(tmp_path / "none")


def with_alpha(path, kind):
    """Colours and alpha of every strength, as they are stored in a file."""
    dice = np.random.default_rng(0)
    stored = dice.random((12, 16, 4)).astype(np.float32)
    if kind != "float":
        stored = (stored * np.iinfo(kind).max).round().astype(kind)
    spec = oiio.ImageSpec(16, 12, 4, kind)
    spec["oiio:UnassociatedAlpha"] = 1
    file = oiio.ImageOutput.create(str(path))
    assert file.open(str(path), spec) and file.write_image(stored) and file.close()
    return stored[..., :3].astype(np.float64), stored[..., 3:].astype(np.float64)


@pytest.mark.parametrize(("background", "light"), [("black", 0), ("white", 1)])
@pytest.mark.parametrize("layout", ["transforms.json", "transforms_train.json"])
def test_pictures_with_alpha_are_seen_over_the_background(folder, background, light, layout):
    color, alpha = with_alpha(folder / "0.png", "uint8")
    lay(folder, layout, {**PAIRED, "split": "train"})
    views = open_capture(folder, background=background).views
    expected = color * alpha / 255 + 255 * light * (1 - alpha / 255)
    pictures = films.load(views)
    assert pictures.dtype == np.uint8
    np.testing.assert_allclose(pictures[0], expected, atol=CODE + SINGLE)


def test_sixteen_bits_and_premultiplied_light_are_composited_too(folder):
    lay(folder, "transforms_train.json", SPLIT)
    color, alpha = with_alpha(folder / "0.png", "uint16")
    (view,) = open_capture(folder, background="white").views
    expected = (color * alpha / 65535 + 65535 - alpha) / 65535
    np.testing.assert_allclose(read_encoded(view), expected, atol=CODE / 65535 + SINGLE)
    color, alpha = with_alpha(folder / "0.exr", "float")
    lay(folder, "transforms_train.json", {**SPLIT, "frames": [{**FRAME, "file_path": "0.exr"}]})
    (view,) = open_capture(folder, background="white").views
    np.testing.assert_allclose(read_encoded(view), srgb_encode(color + 1 - alpha), atol=SINGLE)


def test_without_a_background_alpha_is_dropped_with_a_warning(folder):
    color, _ = with_alpha(folder / "0.png", "uint8")
    lay(folder, "transforms_train.json", SPLIT)
    with pytest.warns(CaptureWarning, match="1 of 1 pictures have alpha .* is ignored. .*=black"):
        pictures = films.load(open_capture(folder, background="none").views)
    np.testing.assert_array_equal(pictures[0], color)


def test_a_background_changes_nothing_where_there_is_no_alpha(folder):
    lay(folder, "transforms_train.json", SPLIT)
    (view,) = open_capture(folder, background="white").views
    np.testing.assert_array_equal(read_encoded(view), 128)


def test_a_background_that_there_is_not_lists_those_that_are(folder):
    lay(folder, "transforms_train.json", SPLIT)
    with pytest.raises(
        ValueError, match="capture.background .* auto, black, white, mask, none, got 'pink'"
    ):
        open_capture(folder, background="pink")


@pytest.mark.parametrize(
    ("word", "says"),
    [
        (
            "capture.format=ns",
            "metashape, neus, alicevision, opensfm, openmvg, bundler, middlebury, record3d, "
            "sevenscenes, kitti, tum, euroc, got 'ns'",
        ),
        ("capture.format=null", "capture.format must be a text, got None"),
        ("capture.format=colmap", "must hold cameras and images"),
        ("capture.background=pink", "must be one of auto, black, white, mask, none, got 'pink'"),
        ("capture.scale=2", "capture.scale (truth_scale) must be in (0, 1], got 2.0"),
        ("capture.scale=half", "capture.scale must be a number, got 'half'"),
        ("capture.crop=8", "capture.crop must be a list, got 8"),
        ("capture.frames=[0,1.5,1]", "three whole numbers: first, last, step"),
        ("capture.test=[cam7]", "a list of the capture's cameras (c), got ['cam7']. A pattern"),
    ],
)
@pytest.mark.filterwarnings("ignore::gaussray.capture.errors.CaptureWarning")
def test_the_command_line_names_what_it_cannot_open(folder, capsys, word, says):
    lay(folder, "transforms_train.json", SPLIT)
    with pytest.raises(SystemExit) as stop:
        main(["reconstruct", f"capture.path={folder}", f"out={folder}/out", word])
    assert stop.value.code == 2 and says in capsys.readouterr().err
    assert not (folder / "out").exists()
