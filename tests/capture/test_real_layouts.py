"""Captures in the layouts that other tools write open as they are."""

import dataclasses
import json
import warnings

import films
import jax.numpy as jnp
import numpy as np
import OpenImageIO as oiio
import pytest
from PIL import Image

from gaussray.camera.camera import project
from gaussray.capture.capture import viewpoints
from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.formats.paired import read_capture
from gaussray.capture.frames import read_encoded, visible_pixels
from gaussray.capture.open import format_of, open_capture
from gaussray.capture.picture_file import read_levels
from gaussray.capture.same_size import same_size
from gaussray.capture.selection import Selection, selected
from gaussray.capture.view_file import check_images
from gaussray.dataset.images import write_image
from gaussray.evaluate.masks import MotionMasks, levels_and_mask
from gaussray.reconstruct.data.motion_mask import activity
from gaussray.reconstruct.data.pictures import footage


W, H = 24, 16
LENS = {"fl_x": 20.0, "fl_y": 20.0, "cx": 12.0, "cy": 8.0, "w": W, "h": H}
# A point and its pixel agree to this many pixels, in single precision.
PIXEL = 1e-4
# Times of rows agree to this, in single precision.
TIME = 1e-5


def pose(x=0.0, mirror=1):
    """A camera at (x, 0, 0) that looks down -z; OpenGL axes."""
    matrix = np.diag([mirror, 1.0, 1.0, 1.0])
    matrix[0, 3] = x
    return matrix.tolist()


def picture(path, value=128, size=(W, H)):
    write_image(path, np.full((size[1], size[0], 3), value, np.uint8))


def lay(folder, frames, **top):
    """A transforms.json, and a picture for each of its frames."""
    for i, frame in enumerate(frames):
        picture(folder / frame["file_path"], 20 + 30 * i)
    document = {**LENS, **top, "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(document))
    return folder


def frame(name, x, **keys):
    return {"file_path": name, "transform_matrix": pose(x), "split": "train", **keys}


@pytest.fixture
def static(tmp_path):
    return lay(tmp_path, [frame(f"images/{i:04d}.png", 0.1 * i) for i in range(5)])


@pytest.mark.filterwarnings("ignore:.*no frame has a time")
def test_frames_without_a_picture_are_left_out_with_one_warning(static):
    for i in (1, 3):
        (static / f"images/{i:04d}.png").unlink()
    with pytest.warns(CaptureWarning, match="2 of 5 frames have no picture, .*0001.png") as caught:
        capture = open_capture(static)
    assert len([w for w in caught if "no picture" in str(w.message)]) == 1
    assert [view.camera_name for view in capture.views] == ["0000", "0002", "0004"]
    with pytest.raises(CaptureError, match="2 of 5 frames have no picture.*Copy"):
        open_capture(static, selection=Selection(missing="error"))
    with pytest.raises(CaptureError, match="capture.missing .* must be one of skip, error"):
        Selection(missing="ignore")


@pytest.mark.filterwarnings("ignore:.*no frame has a time")
def test_a_capture_without_any_picture_is_refused(static):
    for path in (static / "images").iterdir():
        path.unlink()
    remedy = "0000.png. Copy the pictures of these frames there, or remove the frames.$"
    with pytest.raises(CaptureError, match=f"5 of 5 frames have no picture.*{remedy}"):
        open_capture(static)
    # Pictures of another model must not be copied.
    picture(static / "dense/images/0000.png")
    (static / "dense/sparse").mkdir()
    with pytest.raises(CaptureError, match="5 of 5 frames .* name .*/dense, and do not copy it.$"):
        open_capture(static)


@pytest.mark.filterwarnings("ignore:.*no frame has a time")
def test_pictures_of_one_folder_at_different_places_are_different_cameras(static):
    views = open_capture(static).views
    assert [view.camera_name for view in views] == [f"{i:04d}" for i in range(5)]
    held = open_capture(static, selection=Selection(test=("0001*",))).views
    assert [view.split for view in held] == ["train", "test", "train", "train", "train"]


def test_frames_of_a_fixed_rig_in_one_folder_are_cameras_by_their_poses(tmp_path):
    frames = [
        frame(f"images/{c}_{t}.png", x, time=t / 2) for t in (0, 1) for c, x in (("a", 0), ("b", 1))
    ]
    views = open_capture(lay(tmp_path, frames)).views
    assert [view.camera_name for view in views] == ["a_0", "b_0"] * 2
    assert viewpoints(views) == [0, 1, 0, 1]


def rig(folder, named):
    """Two cameras that move together; the picture changes with the place, the world does not."""
    frames = [
        frame(f"{c}/{t}.png", x + 0.2 * t, time=t / 4, **({"camera": c} if named else {}))
        for c, x in (("left", 0), ("right", 1))
        for t in range(4)
    ]
    return lay(folder, frames)


@pytest.mark.parametrize("named", [True, False])
def test_the_frames_of_a_moving_rig_share_cameras_but_no_viewpoints(tmp_path, named):
    views = open_capture(rig(tmp_path, named)).views
    assert [view.camera_name for view in views] == ["left"] * 4 + ["right"] * 4
    assert viewpoints(views) == list(range(8))


def test_no_temporal_median_is_taken_over_frames_of_a_moving_camera(tmp_path):
    views = open_capture(rig(tmp_path, True)).views
    pictures = footage(views, side=8)
    assert len(np.unique(pictures.name)) == 2 and len(np.unique(pictures.viewpoints)) == 8
    found = activity(pictures)
    assert found.background.shape[0] == 8 and not found.moved.any()
    moving = MotionMasks(views)
    assert all(moving.moving(view, levels_and_mask(view)[0]) is None for view in views)


def test_a_fixed_camera_still_tells_what_moves(tmp_path):
    frames = [frame(f"a/{t}.png", 0.0, time=t / 3) for t in range(3)]
    views = open_capture(lay(tmp_path, frames)).views
    assert viewpoints(views) == [0, 0, 0]
    assert activity(footage(views, side=8)).moved.any()
    moving = MotionMasks(views)
    assert [moving.moving(view, levels_and_mask(view)[0]).shape for view in views] == [(H, W)] * 3


def test_a_recorded_trajectory_is_another_viewpoint_at_another_time(tmp_path):
    path = [{"time": t, "transform_matrix": pose(t)} for t in (0.0, 1.0)]
    frames = [frame(f"a/{t}.png", 0.0, time=t / 2, trajectory=path) for t in range(3)]
    views = open_capture(lay(tmp_path, frames)).views
    assert {view.camera_name for view in views} == {"a"} and viewpoints(views) == [0, 1, 2]


def test_every_frame_may_have_its_own_intrinsics(tmp_path):
    frames = [frame(f"{i}/0.png", 0.0, fl_x=20.0 + i, fl_y=30.0 + i, time=0.0) for i in range(3)]
    views = open_capture(lay(tmp_path, frames)).views
    np.testing.assert_array_equal(
        [v.camera.lens.focal for v in views], [[20 + i, 30 + i] for i in range(3)]
    )
    np.testing.assert_array_equal(footage(views, side=8).camera.lens.focal[2], [22, 32])


def test_keys_that_other_tools_write_do_not_warn(tmp_path):
    extra = {"sharpness": 20.1, "frame": 3, "camera_index": 1, "colmap_im_id": 4, "blur_score": 3}
    top = {"aabb_scale": 4, "camera_angle_x": 1.0, "scene_scale": 1, "applied_scale": 1.0}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        open_capture(lay(tmp_path, [frame("a/0.png", 0, time=0.0, **extra)], **top))


@pytest.mark.filterwarnings("ignore:.*no frame has a time")
def test_a_mirrored_pose_is_refused_with_its_frame(tmp_path):
    frames = [frame("a/0.png", 0), {**frame("a/1.png", 0), "transform_matrix": pose(0, mirror=-1)}]
    with pytest.raises(CaptureError, match="frame 1: transform_matrix .*without reflection"):
        open_capture(lay(tmp_path, frames))


def test_what_instant_ngp_leaves_out_follows_from_the_angle_and_the_picture(tmp_path):
    picture(tmp_path / "images/r_0.png")
    document = {"camera_angle_x": 1.0, "frames": [frame("./images/r_0", 0, time=0.0)]}
    (tmp_path / "transforms.json").write_text(json.dumps(document))
    (view,) = read_capture(tmp_path, jnp.float64).views
    assert (view.width, view.height, view.image.name) == (W, H, "r_0.png")
    np.testing.assert_allclose(view.camera.lens.focal, W / 2 / np.tan(0.5), rtol=1e-12)
    np.testing.assert_allclose(view.camera.lens.center, [W / 2, H / 2])


def test_a_stray_json_file_with_frames_is_skipped_with_its_reason(tmp_path):
    lay(tmp_path, [frame("a/0.png", 0, time=0.0)])
    (tmp_path / "other.json").write_text(json.dumps({"frames": [{"time": 3}]}))
    with pytest.warns(CaptureWarning, match="other.json: skipped, it is no file of a capture: "):
        capture = open_capture(tmp_path)
    assert len(capture.views) == 1 and not capture.effects
    (tmp_path / "other.json").write_text(json.dumps({"frames": [{"time": 3}], "effect": "fisheye"}))
    with pytest.raises(CaptureError, match="other.json"):
        open_capture(tmp_path)


PLY = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n" + (
    "property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n"
    "end_header\n1 2 3 255 0 0\n"
)


@pytest.mark.parametrize("named", [True, False])
def test_nerfstudios_sparse_points_are_the_starting_points(tmp_path, named):
    top = {"ply_file_path": "sparse_pc.ply"} if named else {}
    lay(tmp_path, [frame("a/0.png", 0, time=0.0)], **top)
    (tmp_path / "sparse_pc.ply").write_text(PLY)
    points = open_capture(tmp_path).points
    np.testing.assert_array_equal(points.position, [[1, 2, 3]])
    np.testing.assert_array_equal(points.color, [[1, 0, 0]])


def test_a_mask_that_keeps_few_pixels_is_warned_of(tmp_path):
    few = np.zeros((H, W), bool)
    few[:2, :4] = True
    films.write_mask(tmp_path / "few.png", few)
    views = open_capture(lay(tmp_path, [frame("a/0.png", 0, time=0.0, mask_path="few.png")])).views
    with pytest.warns(CaptureWarning, match="masks keep 2.1 % of the training pixels"):
        pictures = footage(views, side=8)
    np.testing.assert_array_equal(pictures.masks(np.arange(1))[0], few)
    films.write_mask(tmp_path / "few.png", ~few)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        footage(views, side=8)


def cut_out(path):
    """A red disc of alpha 1 on nothing, whose hidden colour is green."""
    y, x = np.mgrid[:H, :W]
    inside = np.hypot(x - 12, y - 8) < 6
    stored = np.zeros((H, W, 4), np.uint8)
    stored[..., 1] = 255
    stored[inside] = (255, 0, 0, 255)
    spec = oiio.ImageSpec(W, H, 4, "uint8")
    spec["oiio:UnassociatedAlpha"] = 1
    file = oiio.ImageOutput.create(str(path))
    assert file.open(str(path), spec) and file.write_image(stored) and file.close()
    return inside


@pytest.mark.parametrize(
    ("background", "behind"), [("auto", [0] * 3), ("white", [255] * 3), ("mask", [0, 255, 0])]
)
@pytest.mark.filterwarnings("ignore:alpha below 1 in pictures")
def test_objects_are_cut_out_as_the_background_says(tmp_path, background, behind):
    lay(tmp_path, [frame("a/0.png", 0, time=0.0)])
    inside = cut_out(tmp_path / "a/0.png")
    (view,) = open_capture(tmp_path, background=background).views
    shown = read_encoded(view)
    np.testing.assert_array_equal(shown[inside], np.broadcast_to([255, 0, 0], shown[inside].shape))
    np.testing.assert_array_equal(shown[~inside], np.broadcast_to(behind, shown[~inside].shape))
    expected = inside if background == "mask" else np.ones_like(inside)
    np.testing.assert_array_equal(visible_pixels(view), expected)


def test_alpha_is_warned_of_once_with_a_count(tmp_path):
    lay(tmp_path, [frame(f"{i}/0.png", i, time=0.0) for i in range(3)])
    for i in range(2):
        cut_out(tmp_path / f"{i}/0.png")
    with pytest.warns(CaptureWarning) as caught:
        films.load(open_capture(tmp_path).views)
    assert [str(w.message) for w in caught] == [
        "2 of 3 pictures have alpha below 1, which is composited over black. "
        "capture.background=white, mask or none treats it otherwise."
    ]


def capture_of_sizes(folder, *listed):
    """A capture of one scene whose pictures have these sizes; the axis is off their middle."""
    frames = []
    for i, (w, h) in enumerate(listed):
        picture(folder / f"{i}/0.png", 100, (w, h))
        frames.append(frame(f"{i}/0.png", 0, time=0.0, w=w, h=h, cx=w / 2 + 0.5, cy=h / 2))
    (folder / "transforms.json").write_text(json.dumps({**LENS, "frames": frames}))
    return read_capture(folder)


def test_pictures_of_nearly_one_size_are_cropped_to_it(tmp_path):
    views = capture_of_sizes(tmp_path, (24, 16), (26, 17), (25, 16)).views
    with pytest.warns(CaptureWarning, match=r"3 sizes \(24 x 16, .*cropped to 24 x 16"):
        cropped = same_size(views)
    pictures = footage(cropped, side=8)
    assert pictures.film.width == 24 and pictures.film.height == 16
    point = jnp.array([0.3, -0.2, -4.0])
    for before, after in zip(views, cropped, strict=True):
        left = 0 if after.window is None else after.window.box[0]
        top = 0 if after.window is None else after.window.box[1]
        moved = project(before.camera, point) - jnp.array([left, top], jnp.float32)
        np.testing.assert_allclose(project(after.camera, point), moved, atol=PIXEL)


def test_resized_pictures_of_nearly_one_size_are_cropped_to_it_too(tmp_path):
    capture = capture_of_sizes(tmp_path, (48, 32), (53, 34), (50, 33))
    small = selected(capture, Selection(scale=0.5))
    with pytest.warns(CaptureWarning, match="cropped to 24 x 16"):
        cropped = same_size(small.views)
    pictures = footage(cropped, side=8)
    assert (pictures.film.width, pictures.film.height) == (24, 16)
    point = jnp.array([0.3, -0.2, -4.0])
    for before, after in zip(capture.views, cropped, strict=True):
        left, top, width, height = after.window.box
        assert all(value == int(value) for value in after.window.box)
        assert 0 <= left <= before.width - width and 0 <= top <= before.height - height
        # Not all pictures are resized by one factor: each keeps whole pixels of its file.
        assert abs(width - 48) <= 1 and abs(height - 32) <= 1
        place = np.asarray(project(before.camera, point)) - [left, top]
        moved = place * [24 / width, 16 / height]
        np.testing.assert_allclose(project(after.camera, point), moved, atol=PIXEL)


def test_pictures_of_quite_different_sizes_are_put_into_one_film(tmp_path):
    views = capture_of_sizes(tmp_path, (24, 16), (16, 24)).views
    with pytest.warns(CaptureWarning, match="2 sizes .*in the middle of one of 24 x 24, and"):
        framed = same_size(views)
    assert [view.margin for view in framed] == [(0, 4, 0, 4), (4, 0, 4, 0)]
    pictures = footage(framed, side=8)
    assert (pictures.film.width, pictures.film.height) == (24, 24)
    shown = pictures.masks(np.arange(2))
    for seen, before, after in zip(shown, views, framed, strict=True):
        left, top, _, _ = after.margin
        rows, columns = slice(top, top + before.height), slice(left, left + before.width)
        assert seen[rows, columns].all() and seen.sum() == before.width * before.height
        picture = read_encoded(after)
        np.testing.assert_array_equal(picture[rows, columns], read_encoded(before))
        assert not picture[~seen].any()
        point = jnp.array([0.3, -0.2, -4.0])
        moved = project(before.camera, point) + jnp.array([left, top], jnp.float32)
        np.testing.assert_allclose(project(after.camera, point), moved, atol=PIXEL)


def test_a_margin_masks_what_a_mask_leaves_as_well(tmp_path):
    views = capture_of_sizes(tmp_path, (24, 16), (16, 24)).views
    mask = np.zeros((16, 24, 3), np.uint8)
    mask[:, :5] = 255
    write_image(tmp_path / "mask.png", mask / 255)
    with pytest.warns(CaptureWarning, match="2 sizes"):
        first, _ = same_size([dataclasses.replace(views[0], mask=tmp_path / "mask.png"), views[1]])
    expected = np.zeros((24, 24), bool)
    expected[4:20, :5] = True
    np.testing.assert_array_equal(visible_pixels(first), expected)


def test_pictures_that_are_much_larger_are_made_smaller(tmp_path):
    views = capture_of_sizes(tmp_path, (24, 16), (96, 64)).views
    with pytest.warns(CaptureWarning, match="middle of one of 48 x 32"):
        small, large = same_size(views)
    assert small.margin == (12, 8, 12, 8) and not any(large.margin)
    assert read_encoded(large).shape == (32, 48, 3) and read_encoded(small).shape == (32, 48, 3)
    point = jnp.array([0.3, -0.2, -4.0])
    place = np.asarray(project(views[1].camera, point)) / 2
    np.testing.assert_allclose(project(large.camera, point), place, atol=PIXEL)


def test_rows_around_a_picture_keep_the_times_of_those_in_it(tmp_path):
    views = capture_of_sizes(tmp_path, (24, 16), (16, 24)).views
    camera = views[0].camera
    times = jnp.linspace(0.0, 1.0, 16) ** 2
    shutter = dataclasses.replace(camera.shutter, row_step=jnp.asarray(0.01), row_times=times)
    rolling = dataclasses.replace(camera, shutter=shutter)
    with pytest.warns(CaptureWarning, match="2 sizes"):
        first, _ = same_size([dataclasses.replace(views[0], camera=rolling), views[1]])
    framed = first.camera.shutter
    np.testing.assert_allclose(framed.row_times[4:20], times, atol=TIME)
    np.testing.assert_allclose(framed.row_times[:4], times[0], atol=TIME)
    np.testing.assert_allclose(framed.row_times[20:], times[-1], atol=TIME)
    # Row 4 of the film is the first of the picture.
    begin = framed.row_offset + 4 * framed.row_step
    np.testing.assert_allclose(begin, shutter.row_offset, atol=TIME)


def test_a_capture_of_llff_is_pictures_with_every_eighth_held_out(tmp_path):
    rows = []
    for i in range(9):
        picture(tmp_path / f"images_2/IMG_{i}.png", 10 * i)
        # Columns: down, right, backwards, position, size; of pictures twice as large.
        columns = [[0, -1, 0], [1, 0, 0], [0, 0, 1], [i, 0, 0], [2 * H, 2 * W, 40.0]]
        rows.append([*np.array(columns).T.ravel(), 1.0, 9.0])
    np.save(tmp_path / "poses_bounds.npy", np.array(rows))
    assert format_of(tmp_path) == "llff"
    with pytest.warns(CaptureWarning, match="each 8th of 9 is held out"):
        capture = open_capture(tmp_path)
    assert [view.split for view in capture.views] == ["test", *["train"] * 7, "test"]
    assert capture.views[3].camera_name == "IMG_3"
    np.testing.assert_allclose(capture.views[3].camera.lens.focal, 20)
    # 2 to the right of the camera at x = 3, 4 in front of it: 10 pixels right of the middle.
    pixel = project(capture.views[3].camera, jnp.array([5.0, 0.0, -4.0]))
    np.testing.assert_allclose(pixel, [12 + 10, 8], atol=PIXEL)
    (tmp_path / "images_2/IMG_8.png").unlink()
    with pytest.raises(CaptureError, match="pictures of images_2/, got 9 and 8. Copy"):
        open_capture(tmp_path)


@pytest.mark.filterwarnings("ignore:.*each 8th of 3 is held out")
def test_masks_in_a_folder_beside_the_pictures_count(tmp_path):
    """As COLMAP (`IMG_0.png.png`) and nerfstudio (`IMG_2.png`) name them."""
    rows = [[0, 1, 0, i, H, -1, 0, 0, 0, W, 0, 0, 1, 0, 20.0, 1.0, 9.0] for i in range(3)]
    np.save(tmp_path / "poses_bounds.npy", np.array(rows))
    for i in range(3):
        picture(tmp_path / f"images/IMG_{i}.png", 10 * i)
    white = np.zeros((H, W, 3), np.uint8)
    white[:, :5] = 255
    for name in ("IMG_0.png.png", "IMG_2.png"):
        write_image(tmp_path / "masks" / name, white)
    with pytest.warns(CaptureWarning) as warned:
        views = open_capture(tmp_path).views
    told = [str(one.message) for one in warned]
    assert any("masks: 2 of 3 pictures have a mask there" in text for text in told)
    assert [int(visible_pixels(view).sum()) for view in views] == [5 * H, W * H, 5 * H]
    for path in (tmp_path / "masks").iterdir():
        path.unlink()
    Image.fromarray(white).save(tmp_path / "masks/IMG_1.jpg")
    with pytest.warns(CaptureWarning, match="masks: 1 of 3 pictures have a mask there"):
        views = open_capture(tmp_path).views
    assert [view.mask is not None for view in views] == [False, True, False]
    (tmp_path / "masks/IMG_1.jpg").rename(tmp_path / "masks/mask_1.jpg")
    with pytest.warns(CaptureWarning, match=r"its 1 files, such as mask_1\.jpg, are not used"):
        open_capture(tmp_path)


@pytest.mark.filterwarnings("ignore:.*no frame has a time")
@pytest.mark.parametrize("colors", [(0, 3), ((255, 0, 0), (0, 0, 255)), (90, 160)])
def test_label_maps_in_the_folder_of_masks_hide_nothing(static, colors):
    for k in range(5):
        labels = np.empty((H, W, 3), np.uint8)
        labels[:, :5], labels[:, 5:] = colors
        write_image(static / f"masks/{k:04d}.png", labels)
    with pytest.warns(CaptureWarning, match="0000.png, are not used: masks are black and white"):
        views = open_capture(static).views
    assert all(view.mask is None for view in views)


@pytest.mark.filterwarnings("ignore:.*no frame has a time")
@pytest.mark.parametrize("seen", [[], [3]])
def test_masks_may_hide_whole_pictures(static, seen):
    for k in range(5):
        write_image(static / f"masks/{k:04d}.png", np.full((H, W, 3), 255 * (k in seen), np.uint8))
    with pytest.warns(CaptureWarning, match="masks: 5 of 5 pictures have a mask there"):
        views = open_capture(static).views
    assert [bool(visible_pixels(view).any()) for view in views] == [k in seen for k in range(5)]


@pytest.mark.filterwarnings("ignore:.*no frame has a time")
def test_masks_in_a_folder_count_beside_a_json_file_that_names_none(static):
    half = np.zeros((H, W, 3), np.uint8)
    half[:, :5] = 255
    write_image(static / "masks/0001.png", half)
    with pytest.warns(CaptureWarning, match="masks: 1 of 5 pictures have a mask there"):
        views = open_capture(static).views
    assert [int(visible_pixels(view).sum()) for view in views] == [W * H, 5 * H, *[W * H] * 3]
    document = json.loads((static / "transforms.json").read_text())
    document["frames"][0]["mask_path"] = "masks/0001.png"
    (static / "transforms.json").write_text(json.dumps(document))
    with warnings.catch_warnings():
        warnings.filterwarnings("error", "masks")
        views = open_capture(static).views
    assert [view.mask is not None for view in views] == [True, *[False] * 4]


def dome(folder):
    """Two cameras, three time steps, as Dynamic 3D Gaussians have them; one camera is held out."""
    for name, cameras in (("train", (0, 1)), ("test", (7,))):
        document = {"w": W, "h": H, "k": [], "w2c": [], "fn": [], "cam_id": []}
        for t in range(3):
            matrices, files = [], []
            for c in cameras:
                matrix = np.eye(4)
                matrix[0, 3] = -c  # the camera is at x = c
                matrices.append(matrix.tolist())
                files.append(f"{c}/{t:06d}.png")
                picture(folder / "ims" / files[-1], 10 * t)
            document["k"].append([[[20, 0, 12], [0, 20, 8], [0, 0, 1]]] * len(cameras))
            document["w2c"].append(matrices)
            document["fn"].append(files)
            document["cam_id"].append(list(cameras))
        (folder / f"{name}_meta.json").write_text(json.dumps(document))
    np.savez(folder / "init_pt_cld.npz", data=np.array([[1.0, 2, 3, 1, 0, 0, 1]]))


def test_a_capture_of_dynamic_3d_gaussians_opens(tmp_path):
    dome(tmp_path)
    capture = open_capture(tmp_path)
    assert format_of(tmp_path) == "dynamic3dgs" and len(capture.views) == 9
    assert {view.camera_name for view in capture.views if view.split == "test"} == {"cam7"}
    assert [view.time for view in capture.views[:6:2]] == [0, 1 / 3, 2 / 3]
    np.testing.assert_array_equal(capture.points.color, [[1, 0, 0]])
    # OpenCV axes: 2 to the right of camera 1 and 4 in front of it.
    pixel = project(capture.views[1].camera, jnp.array([3.0, 0.0, 4.0]))
    np.testing.assert_allclose(pixel, [12 + 10, 8], atol=PIXEL)
    assert viewpoints(capture.views) == [0, 1] * 3 + [2] * 3


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda d: d.pop("w2c"), "w2c must be a list"),
        (lambda d: d["fn"][1].pop(), "as many cameras at time step 1, got 2, 2, 1, 2"),
        (lambda d: d["k"][0][1][0].__setitem__(1, 0.5), "frame 1: k must be .*without skew"),
        (lambda d: d["w2c"][0].__setitem__(0, [[0.0] * 4] * 4), "frame 0: w2c must be an inv"),
        (
            lambda d: d["w2c"][0].__setitem__(0, np.diag([-1.0, 1, 1, 1]).tolist()),
            "frame 0: w2c must be a world-to-camera matrix without reflection",
        ),
        (lambda d: d["fn"][0].__setitem__(0, "../../x.png"), "must name a file in"),
    ],
)
def test_a_wrong_dome_is_named_with_its_place(tmp_path, change, says):
    dome(tmp_path)
    document = json.loads((tmp_path / "train_meta.json").read_text())
    change(document)
    (tmp_path / "train_meta.json").write_text(json.dumps(document))
    with pytest.raises(CaptureError, match=f"train_meta.json.*{says}"):
        open_capture(tmp_path)


@pytest.mark.filterwarnings("ignore:.*no camera has a folder")
def test_a_project_of_colmap_opens_at_its_undistorted_pictures(tmp_path):
    place = tmp_path / "dense/0/sparse"
    place.mkdir(parents=True)
    picture(tmp_path / "dense/0/images/a.png")
    (place / "cameras.txt").write_text(f"1 PINHOLE {W} {H} 20 20 12 8\n")
    (place / "images.txt").write_text("1 1 0 0 0 0 0 0 1 a.png\n\n")
    assert format_of(tmp_path) == "colmap"
    (view,) = open_capture(tmp_path).views
    assert view.image == (tmp_path / "dense/0/images/a.png").resolve()


@pytest.mark.filterwarnings("ignore:.*no camera has a folder")
@pytest.mark.parametrize(
    ("stored", "opened"),
    [
        (["dense/0/images/a.png"], "dense/0/images/a.png"),
        (["images/a.png", "dense/0/images/a.png"], "images/a.png"),
        (["images/other.png", "dense/0/images/a.png"], "dense/0/images/a.png"),
    ],
)
def test_of_the_models_of_a_project_that_with_pictures_is_opened(tmp_path, stored, opened):
    for place in ("sparse/0", "dense/0/sparse"):
        folder = tmp_path / place
        folder.mkdir(parents=True)
        (folder / "cameras.txt").write_text(f"1 PINHOLE {W} {H} 20 20 12 8\n")
        (folder / "images.txt").write_text("1 1 0 0 0 0 0 0 1 a.png\n\n")
    for name in stored:
        picture(tmp_path / name)
    assert format_of(tmp_path) == "colmap"
    (view,) = open_capture(tmp_path).views
    assert view.image == (tmp_path / opened).resolve()


@pytest.mark.parametrize("text", ['{"frames": 120}', '{"frames": [{"frame": 0}]}', "{,}", "[1]"])
def test_json_files_of_other_programs_make_no_capture(tmp_path, text):
    (tmp_path / "settings.json").write_text(text)
    with pytest.raises(CaptureError, match="must hold the files of one format"):
        open_capture(tmp_path)


@pytest.mark.filterwarnings("ignore:.*is taken as static")
@pytest.mark.parametrize("text", ['{"frames": 120}', "{,}", "[1]"])
def test_malformed_json_files_beside_a_capture_are_left_alone(static, text):
    (static / "settings.json").write_text(text)
    assert not open_capture(static).effects


@pytest.mark.filterwarnings("ignore:.*is taken as static")
def test_a_copy_of_the_file_is_no_effect(static):
    (static / "transforms_old.json").write_text((static / "transforms.json").read_text())
    with pytest.warns(CaptureWarning, match="transforms_old.json: is left out: it is named after"):
        assert not open_capture(static).effects
    document = json.loads((static / "transforms.json").read_text())
    (static / "transforms_old.json").write_text(json.dumps({**document, "effect": "blur"}))
    with pytest.warns(CaptureWarning, match="pictures to score, .*, are training pictures, too"):
        assert list(open_capture(static).effects) == ["blur"]


@pytest.mark.filterwarnings("ignore:.*is taken as static")
def test_a_copy_of_a_training_picture_is_no_picture_to_score(static):
    document = json.loads((static / "transforms.json").read_text())
    first = document["frames"][0] | {"split": "train"}
    copy = first | {"file_path": "copy.png", "split": "test"}
    image = static / first["file_path"]
    (static / "copy.png").write_bytes(image.read_bytes())
    (static / "transforms.json").write_text(json.dumps({**document, "frames": [first, copy]}))
    with pytest.warns(CaptureWarning, match="1 pictures to score, first copy.png, .* or copies"):
        open_capture(static)
    picture(static / "copy.png", 77)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", ".*is taken as static")
        open_capture(static)


@pytest.mark.filterwarnings("ignore:.*is taken as static")
def test_a_byte_order_mark_is_no_part_of_the_text(static):
    path = static / "transforms.json"
    path.write_text(path.read_text(), encoding="utf-8-sig")
    assert open_capture(static).views
    path.write_text(path.read_text(encoding="utf-8-sig"), encoding="utf-16")
    with pytest.raises(CaptureError, match="must be UTF-8 text.*Save it as UTF-8"):
        open_capture(static)


def matrix(change):
    """A pose with rotation, as some tools write it."""
    turn = np.eye(4)
    turn[:3] = [[0, 0, 1, 3], [1, 0, 0, 4], [0, 1, 0, 5]]
    return turn, np.array(change(turn)).tolist()


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda m: m.T, "transform_matrix is transposed"),
        (lambda m: 0.002 * m, "transform_matrix is divided by 0.002"),
        (lambda m: m.ravel(), ""),
    ],
)
def test_matrices_that_are_written_otherwise_are_made_right(tmp_path, change, told):
    true, written = matrix(change)
    lay(tmp_path, [{**frame("a.png", 0, time=0.0, camera="a"), "transform_matrix": written}])
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        camera = open_capture(tmp_path).views[0].camera
    assert np.allclose(camera.trajectory.translation[0], true[:3, 3])
    assert any(told in str(one.message) for one in seen) if told else not seen


def test_a_mirrored_matrix_is_refused_with_what_to_negate(tmp_path):
    mirrored = {**frame("a.png", 0, time=0.0), "transform_matrix": pose(mirror=-1)}
    lay(tmp_path, [mirrored])
    with pytest.raises(CaptureError, match="Negate the column of that axis of the camera"):
        open_capture(tmp_path)


def test_a_key_that_is_like_a_known_one_is_asked_for(tmp_path):
    lay(tmp_path, [frame("a.png", 0, time=0.0, f1_x=20.0)])
    with pytest.warns(CaptureWarning, match="f1_x is unknown and ignored.$"):
        open_capture(tmp_path)
    given = {key: value for key, value in LENS.items() if key != "fl_x"}
    document = {**given, "camera_angle_x": 1.0, "frames": [frame("a.png", 0, time=0.0, f1_x=20.0)]}
    (tmp_path / "transforms.json").write_text(json.dumps(document))
    with pytest.warns(CaptureWarning, match=r"f1_x is unknown and ignored. Did you mean fl_x\?"):
        open_capture(tmp_path)


def test_a_pointer_of_git_lfs_is_named(static):
    pointer = "version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n"
    (static / "transforms.json").write_text(pointer)
    with pytest.raises(OSError, match="is a pointer of Git LFS.*git lfs pull"):
        open_capture(static)


@pytest.mark.parametrize("orientation", [6, 8])
def test_a_picture_that_is_stored_lying_is_turned_to_the_cameras_size(tmp_path, orientation):
    upright = np.random.default_rng(0).integers(0, 255, (H, W, 3), np.uint8)
    exif = Image.Exif()
    exif[274] = orientation
    # Pillow's own way: orientation 6 is seen after a quarter turn clockwise.
    stored = np.rot90(upright, 1 if orientation == 6 else -1)
    document = {**LENS, "static": True, "frames": [frame("a.png", 0)]}
    Image.fromarray(np.ascontiguousarray(stored)).save(tmp_path / "a.png", exif=exif)
    (tmp_path / "transforms.json").write_text(json.dumps(document))
    (view,) = open_capture(tmp_path).views
    assert (read_levels(view.image, W, H) == upright).all()
    check_images([view])


def test_levels_in_floating_point_are_refused(tmp_path):
    lay(tmp_path, [frame("a.png", 0, time=0.0)])
    spec = oiio.ImageSpec(W, H, 3, "float")
    file = oiio.ImageOutput.create("tiff")
    file.open(str(tmp_path / "a.tif"), spec)
    file.write_image(np.full((H, W, 3), 200, np.float32))
    file.close()
    (tmp_path / "transforms.json").write_text(
        json.dumps({**LENS, "static": True, "frames": [frame("a.tif", 0)]})
    )
    with pytest.raises(CaptureError, match="must hold linear light, 1 for white, got .* 200"):
        read_encoded(open_capture(tmp_path).views[0])
