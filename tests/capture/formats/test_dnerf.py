"""D-NeRF's and BlenderNeRF's folders become cameras whose rays are those of their own formulas."""

import copy
import json
import math

import films
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.camera.camera import camera_ray
from gaussray.camera.lens import Pinhole
from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.formats.dnerf import read_splits
from gaussray.capture.view_file import check_images
from gaussray.cli.main import main
from gaussray.dataset.images import write_image


WIDTH, HEIGHT = 16, 12
ANGLE = 0.6911112070083618
# Turned by a third about (1, 1, 1): x -> y -> z -> x, so no axis stands for itself.
POSE = [[0, 0, 1, 1.5], [1, 0, 0, -2.0], [0, 1, 0, 0.25], [0, 0, 0, 1]]
CORNERS = [(0, 0), (WIDTH - 1, 0), (3, HEIGHT - 1)]
# Double precision: a dozen roundings of numbers near one.
EXACT = 1e-12
PLY = "ply\nformat ascii 1.0\nelement vertex 1\n" + "".join(
    f"property {kind} {name}\n"
    for kind, names in (("float", "xyz"), ("uchar", ("red", "green", "blue")))
    for name in names
)


def moved(by):
    """The pose, so far along x."""
    pose = copy.deepcopy(POSE)
    pose[0][3] += by
    return pose


def picture(path, width=WIDTH, height=HEIGHT):
    write_image(path, np.full((height, width, 3), 128, np.uint8))


def write(folder, name, content):
    (folder / f"transforms_{name}.json").write_text(json.dumps(content))


def points(path, x):
    path.write_text(f"{PLY}end_header\n{x} 2 3 255 0 0\n")


def dnerf_document(split, times):
    """What D-NeRF's file of a split holds: one camera after the other, each at its own time."""
    frames = [
        {
            "file_path": f"./{split}/r_{k:03d}",
            "rotation": 0.01,
            "time": time,
            "transform_matrix": moved(0.5 * k),
        }
        for k, time in enumerate(times)
    ]
    return {"camera_angle_x": ANGLE, "frames": frames}


@pytest.fixture
def dnerf(tmp_path):
    """A folder in D-NeRF's layout, with pictures."""
    for split, times in (("train", (0.0, 0.5, 1.0)), ("test", (0.25, 0.75)), ("val", (0.1,))):
        write(tmp_path, split, dnerf_document(split, times))
        for k in range(len(times)):
            picture(tmp_path / split / f"r_{k:03d}.png")
    (tmp_path / "transforms_val.json").unlink()
    return tmp_path


def blender_document(split, full):
    """What BlenderNeRF writes: one camera's intrinsics (or its angle alone), no times."""
    frames = [
        {"file_path": f"images_{split}/{k:04d}.png", "transform_matrix": moved(0.5 * k)}
        for k in (1, 2)
    ]
    top = {"camera_angle_x": ANGLE}
    if full:
        lens = {"fl_x": 20.0, "fl_y": 21.0, "k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0}
        top |= {"camera_angle_y": 0.5, **lens, "cx": 8.5, "cy": 5.5}
        top |= {"w": float(WIDTH), "h": float(HEIGHT), "aabb_scale": 4}
    return {**top, "frames": frames}


def blender(folder, full):
    for split in ("train", "test"):
        write(folder, split, blender_document(split, full))
        for k in (1, 2):
            picture(folder / f"images_{split}" / f"{k:04d}.png")
    return folder


def edited(folder, change, split="train"):
    """The folder after a change of a split's document."""
    path = folder / f"transforms_{split}.json"
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))
    return folder


def check_rays(view, pose, focal, center):
    """Rays of a few pixels against Blender's: x right, y up, looking down -z."""
    pose = np.array(pose)
    for column, row in CORNERS:
        pixel = jnp.array([column, row], jnp.float64)
        ray = jax.jit(camera_ray)(view.camera, pixel, jnp.full(5, 0.5))
        ours = np.array([
            (column + 0.5 - center[0]) / focal[0], -(row + 0.5 - center[1]) / focal[1], -1.0
        ])  # fmt: skip
        expected = pose[:3, :3] @ (ours / np.linalg.norm(ours))
        np.testing.assert_allclose(ray.direction, expected, atol=EXACT)
        np.testing.assert_allclose(ray.origin, pose[:3, 3], atol=EXACT)


def test_a_dnerf_frame_is_a_pinhole_of_its_angle_with_the_axis_in_the_centre(dnerf):
    focal = WIDTH / (2 * math.tan(ANGLE / 2))
    views = read_splits(dnerf, jnp.float64).views
    for k, view in enumerate(views[:3]):
        check_rays(view, moved(0.5 * k), (focal, focal), (WIDTH / 2, HEIGHT / 2))
        assert (view.width, view.height) == (WIDTH, HEIGHT)


def test_dnerf_times_splits_and_pictures_are_those_of_the_files(dnerf):
    capture = read_splits(dnerf)
    assert [view.time for view in capture.views] == [0.0, 0.5, 1.0, 0.25, 0.75]
    assert [view.split for view in capture.views] == ["train"] * 3 + ["test"] * 2
    assert capture.views[3].image == dnerf / "test" / "r_000.png"
    assert capture.time_range == (0, 1) and capture.time_unit == "normalised"
    assert capture.effects == {} and capture.points is None
    check_images(capture.views)


def test_every_frame_of_a_moving_camera_is_a_camera_of_its_own(dnerf):
    names = [view.camera_name for view in read_splits(dnerf).views]
    assert names == ["train_r_000", "train_r_001", "train_r_002", "test_r_000", "test_r_001"]


def test_frames_of_one_pose_and_one_lens_are_one_camera(dnerf):
    def stand(content):
        content["frames"][2]["transform_matrix"] = content["frames"][0]["transform_matrix"]

    def zoom(content):
        content["frames"][2]["camera_angle_x"] = 0.5

    def name(content):
        content["frames"][1]["camera"] = "crane"

    first, second, third, *_ = read_splits(edited(dnerf, stand)).views
    assert (first.camera_name, third.camera_name) == ("train_r_000", "train_r_000")
    assert second.camera_name == "train_r_001"
    views = read_splits(edited(edited(dnerf, zoom), name)).views
    assert [v.camera_name for v in views[:3]] == ["train_r_000", "crane", "train_r_002"]


def test_the_type_of_number_is_the_callers(dnerf):
    for kind in (jnp.float32, jnp.float64):
        leaves = jax.tree.leaves([view.camera for view in read_splits(dnerf, kind).views])
        assert {leaf.dtype for leaf in leaves} == {jnp.dtype(kind)}


def test_a_jpeg_is_found_where_there_is_no_png(dnerf):
    path = dnerf / "train" / "r_001.png"
    path.rename(path.with_suffix(".jpg"))
    assert read_splits(dnerf).views[1].image == path.with_suffix(".jpg")


def test_the_validation_split_is_left_out_with_a_warning(dnerf):
    write(dnerf, "val", dnerf_document("val", (0.1,)))
    with pytest.warns(CaptureWarning, match="transforms_val.json beside it is not read"):
        assert len(read_splits(dnerf).views) == 5


def test_the_training_split_alone_is_a_capture(dnerf):
    (dnerf / "transforms_test.json").unlink()
    assert {view.split for view in read_splits(dnerf).views} == {"train"}


def position(folder):
    """Where the capture's points are."""
    points = read_splits(folder).points
    assert points is not None
    return points.position


def test_points_are_those_of_blendernerf_or_of_4dgaussians(dnerf):
    points(dnerf / "fused.ply", 1)
    np.testing.assert_array_equal(position(dnerf), [[1, 2, 3]])
    points(dnerf / "points3d.ply", 5)
    with pytest.warns(CaptureWarning, match="points3d.ply holds the starting points; fused.ply"):
        np.testing.assert_array_equal(position(dnerf), [[5, 2, 3]])
    points(dnerf / "mine.ply", 7)
    edited(dnerf, lambda content: content.update(ply_file_path="mine.ply"))
    np.testing.assert_array_equal(position(dnerf), [[7, 2, 3]])


@pytest.mark.parametrize("full", [False, True])
def test_a_blendernerf_folder_is_a_static_capture(tmp_path, full):
    with pytest.warns(CaptureWarning, match="no frame has a time") as caught:
        capture = read_splits(blender(tmp_path, full), jnp.float64)
    assert len(caught) == 1
    angle = WIDTH / (2 * math.tan(ANGLE / 2))
    focal, center = ((20, 21), (8.5, 5.5)) if full else ((angle, angle), (WIDTH / 2, HEIGHT / 2))
    for view, pose in zip(capture.views, [moved(0.5), moved(1.0)] * 2, strict=True):
        check_rays(view, pose, focal, center)
    assert [view.split for view in capture.views] == ["train"] * 2 + ["test"] * 2
    assert capture.views[2].camera_name == "images_test_0001"
    assert capture.time_range == (0, 0)


def test_blendernerfs_distortion_is_opencvs(tmp_path):
    folder = edited(blender(tmp_path, True), lambda c: c.update(k1=0.1, k2=-0.02, p1=1e-3, p2=2e-3))
    with pytest.warns(CaptureWarning, match="no frame has a time"):
        view = read_splits(folder, jnp.float64).views[0]
    np.testing.assert_array_equal(view.camera.lens.distortion, [0.1, -0.02, 1e-3, 2e-3, 0, 0, 0, 0])


def test_pixels_are_square_where_only_one_focal_length_is_given(tmp_path):
    folder = edited(blender(tmp_path, True), lambda content: content.pop("fl_y"))
    with pytest.warns(CaptureWarning, match="no frame has a time"):
        view = read_splits(folder, jnp.float64).views[0]
    check_rays(view, moved(0.5), (20, 20), (8.5, 5.5))


def test_a_windows_separator_is_one(tmp_path):
    def turn(content):
        content["frames"][0]["file_path"] = "images_train\\0001.png"

    with pytest.warns(CaptureWarning, match="no frame has a time"):
        view = read_splits(edited(blender(tmp_path, True), turn)).views[0]
    assert view.image == tmp_path / "images_train" / "0001.png"


def test_frames_of_a_static_capture_are_cameras_of_their_own(tmp_path):
    def stand(content):
        content["frames"][1]["transform_matrix"] = content["frames"][0]["transform_matrix"]

    with pytest.warns(CaptureWarning, match="no frame has a time"):
        views = read_splits(edited(blender(tmp_path, False), stand)).views
    assert len({view.camera_name for view in views}) == len(views)


def test_null_is_absent(dnerf):
    change = {"w": None, "h": None, "fl_x": None, "camera": None}
    view = read_splits(edited(dnerf, lambda content: content.update(change)), jnp.float64).views[0]
    focal = WIDTH / (2 * math.tan(ANGLE / 2))
    check_rays(view, POSE, (focal, focal), (WIDTH / 2, HEIGHT / 2))
    assert view.camera_name == "train_r_000"


def test_a_matrix_gives_the_intrinsics(dnerf):
    matrix = [[20.0, 0, 8.5], [0, 21.0, 5.5], [0, 0, 1]]
    change = {"K": matrix, "camera_angle_x": None}
    folder = edited(dnerf, lambda content: content.update(change))
    check_rays(read_splits(folder, jnp.float64).views[0], POSE, (20, 21), (8.5, 5.5))
    # Numbers of their own have precedence.
    own = edited(dnerf, lambda content: content.update({"cx": 7.0}))
    check_rays(read_splits(own, jnp.float64).views[0], POSE, (20, 21), (7, 5.5))


def of_frame(key, value):
    return lambda content: content["frames"][1].update({key: value})


def of_top(**values):
    return lambda content: content.update(values)


WRONG = [
    (of_top(camera_angle_x=None), "frame 0: camera_angle_x must be a number.*or fl_x in pixels"),
    (of_top(camera_angle_x="0.7"), "frame 0: camera_angle_x must be a finite number, got '0.7'"),
    (of_top(camera_angle_x=39.6), "camera_angle_x must be an angle.*got 39.6.*Divide degrees"),
    (of_top(camera_angle_x=0), "camera_angle_x must be an angle in radians, above 0.*got 0"),
    (of_top(K=[[20, 0, 8], [0, 20, 6]]), r"frame 0: K must be the matrix .*got \[\[20.*give fl_x"),
    (of_top(K="wide"), "frame 0: K must be the matrix .*got 'wide'"),
    (of_top(frames=[]), r"frames must be a list of at least one frame, got \[\]"),
    (of_top(frames=[3]), r"frames\[0\] must be a block of keys, got 3"),
    (of_top(w=32), "frame 0: w and h must be .* 32 x 12, but .*r_000.png is 16 x 12.*Correct w"),
    (of_top(h=0), "frame 0: h must be a whole number of at least 1, got 0"),
    (of_frame("file_path", None), "frame 1: file_path must be a text, got None"),
    (of_frame("time", None), "frame 1: time must be a number, got nothing. Give every frame"),
    (of_frame("split", "val"), "frame 1: split must be one of train, test, got 'val'"),
    (
        of_frame("transform_matrix", np.diag([2.0, 2, 2, 1]).tolist()),
        "frame 1: transform_matrix must be a rigid .* without scale.*Divide",
    ),
    (
        of_frame("transform_matrix", np.diag([1.0, 1, 1.5, 1]).tolist()),
        "frame 1: transform_matrix must be a rigid .* without shear or unequal scale",
    ),
]


@pytest.mark.parametrize(("change", "says"), WRONG, ids=[str(k) for k in range(len(WRONG))])
def test_every_wrong_value_is_named_with_its_file_and_rule(dnerf, change, says):
    with pytest.raises(CaptureError, match=f"(?s)transforms_train.json.*{says}"):
        read_splits(edited(dnerf, change))


def test_a_training_split_without_any_picture_is_refused(dnerf):
    for path in (dnerf / "train").iterdir():
        path.unlink()
    says = "transforms_train.json, frame 0: file_path must name a picture, got './train/r_000.png'"
    with pytest.raises(FileNotFoundError, match=says):
        read_splits(dnerf)


def test_where_every_test_picture_is_missing_none_is_held_out(dnerf):
    for path in (dnerf / "test").iterdir():
        path.unlink()
    says = "transforms_test.json: nothing is held out.*got './test/r_000.png'"
    with pytest.warns(CaptureWarning, match=says):
        capture = read_splits(dnerf)
    assert {view.split for view in capture.views} == {"train"}


def test_a_later_picture_of_another_size_is_found_when_it_is_opened(dnerf):
    picture(dnerf / "train" / "r_002.png", width=20)
    views = read_splits(dnerf).views
    with pytest.raises(CaptureError, match="r_002.png: the picture must be w x h = 16 x 12"):
        films.load(views)


def test_a_folder_without_its_training_file_says_so(dnerf):
    (dnerf / "transforms_train.json").unlink()
    with pytest.raises(CaptureError, match="must hold transforms_train.json, got none. Add"):
        read_splits(dnerf)
    with pytest.raises(FileNotFoundError, match="none: the capture folder does not exist"):
        read_splits(dnerf / "none")


@pytest.mark.parametrize("split", ["train", "test"])
def test_times_in_one_split_alone_are_an_error(dnerf, split):
    def still(content):
        for frame in content["frames"]:
            del frame["time"]

    with pytest.raises(CaptureError, match=f"transforms_{split}.json, frame 0: time must .*both"):
        read_splits(edited(dnerf, still, split))


def test_an_unknown_key_is_warned_of(dnerf):
    with pytest.warns(CaptureWarning, match="transforms_train.json, frame 1: the key tiem is unk"):
        read_splits(edited(dnerf, of_frame("tiem", 0.5)))


@pytest.mark.slow
def test_a_dnerf_folder_is_reconstructed_and_scored_from_the_command_line(tmp_path):
    truth, run = tmp_path / "truth", tmp_path / "run"
    toy.write_capture(truth, toy.scene())
    paired = json.loads((truth / "transforms.json").read_text())
    lens = toy.camera().lens
    assert isinstance(lens, Pinhole)
    angle = 2 * math.atan(toy.SIZE / 2 / float(lens.focal[0]))
    (truth / "transforms.json").unlink()
    for split in ("train", "test"):
        frames = [
            {
                "file_path": frame["file_path"].removesuffix(".png"),
                "time": frame["time"],
                "transform_matrix": frame["transform_matrix"],
            }
            for frame in paired["frames"]
            if frame["split"] == split
        ]
        write(truth, split, {"camera_angle_x": angle, "frames": frames})
    fit = toy.overrides(toy.SHORT)
    main(["reconstruct", f"capture.path={truth}", f"out={run}", "quiet=true", *fit])
    main(["evaluate", f"scene={run}", f"truth={truth}", "quiet=true"])
    report = json.loads((run / "evaluation" / "report.json").read_text())
    assert report["effects"]["pinhole"]["frames"] == len(toy.TIMES)
    assert report["scene"]["moving"] > 0
