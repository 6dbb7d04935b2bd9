"""Photographs with the cameras of AliceVision and Meshroom."""

import json

import numpy as np
import pytest
from known_photograph import (
    PIXELS,
    PLACE,
    TURN,
    H,
    W,
    distorted,
    fisheye,
    pixels,
    seen_points,
    write_picture,
)
from scipy.spatial.transform import Rotation

from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.formats.alicevision import read_alicevision
from gaussray.capture.open import format_of, open_capture


BROWN = {"k1": -0.1, "k2": 0.05, "k3": -0.02, "p1": 0.003, "p2": -0.002}
FISHEYE = [0.02, -0.01, 3e-3, -1e-3]
NEW, OLD = (1, 2, 9), (1, 1, 0)


def texts(value):
    """All numbers as texts, as AliceVision writes them; an empty list as an empty text."""
    if isinstance(value, dict):
        return {key: texts(one) for key, one in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [texts(one) for one in value] if len(value) else ""
    return str(value)


def lens(kind="none", k=(), **more):
    """Focal lengths of 50 pixels; the axis 1.5 and -2.5 pixels off the middle."""
    size = {"intrinsicId": 7, "width": W, "height": H, "sensorWidth": 32.0, "sensorHeight": 24.0}
    focal = {"focalLength": 25.0, "pixelRatio": 1, "principalPoint": (1.5, -2.5)}
    types = {"type": "pinhole", "distortionType": kind, "undistortionType": "none"}
    return {**size, **focal, **types, "distortionParams": k, **more}


def old_lens(kind="pinhole", k=()):
    size = {"intrinsicId": 7, "width": W, "height": H}
    focal = {"pxFocalLength": 50, "principalPoint": (W / 2 + 1.5, H / 2 - 2.5)}
    return {**size, **focal, "type": kind, "distortionParams": k}


def transform(turn=TURN, place=PLACE):
    # Eigen's order: the rotation to the camera, column by column.
    return {"rotation": turn.T.ravel(order="F"), "center": place}


def view(number=1, path="/home/someone/photos/a.png", **more):
    return {"viewId": number, "poseId": number, "intrinsicId": 7, "path": path, **more}


def posed(number=1, **more):
    return {"poseId": number, "pose": {"transform": transform(**more), "locked": "1"}}


def sfm(version=NEW, **more):
    base = {"version": version, "views": [view()], "intrinsics": [lens()], "poses": [posed()]}
    return {**base, **more}


def lay(folder, content, name="cameras.sfm"):
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(json.dumps(texts(content)))


@pytest.fixture
def folder(tmp_path):
    for name in ("a", "b"):
        write_picture(tmp_path / "images" / f"{name}.png")
    return tmp_path


def lay_numbers(folder, content):
    """A project whose numbers are not texts."""
    (folder / "cameras.sfm").write_text(json.dumps(content, default=np.ndarray.tolist))


def only_view(folder):
    with pytest.warns(CaptureWarning, match="1 of 1 are found if it begins with images/"):
        (found,) = read_alicevision(folder).views
    return found


@pytest.mark.parametrize(
    ("version", "made", "image"),
    [
        (NEW, lens(), distorted),
        (OLD, old_lens(), distorted),
        (NEW, lens("radialk1", [-0.1]), lambda own: distorted(own, -0.1)),
        (OLD, old_lens("radial1", [-0.1]), lambda own: distorted(own, -0.1)),
        (NEW, lens("RadialK3", [-0.1, 0.05, 0.02]), lambda own: distorted(own, -0.1, 0.05, 0.02)),
        (OLD, old_lens("radial3", [-0.1, 0.05, 0.02]), lambda o: distorted(o, -0.1, 0.05, 0.02)),
        (NEW, lens("brown", list(BROWN.values())), lambda own: distorted(own, **BROWN)),
        (OLD, old_lens("brown", list(BROWN.values())), lambda own: distorted(own, **BROWN)),
        (NEW, lens("fisheye", FISHEYE), lambda own: fisheye(own, *FISHEYE)),
        (OLD, old_lens("fisheye4", [0.02, 0, 0, 0]), lambda own: fisheye(own, 0.02)),
    ],
)  # fmt: skip
def test_a_point_falls_where_alicevision_puts_it(folder, version, made, image):
    lay(folder, sfm(version, intrinsics=[made]))
    assert format_of(folder) == "alicevision"
    seen = only_view(folder)
    world, own = seen_points()
    # The middle of the first pixel is 0 there, 0.5 here.
    expected = 50 * image(own) + (W / 2 + 1.5 + 0.5, H / 2 - 2.5 + 0.5)
    np.testing.assert_allclose(pixels(seen, world), expected, atol=PIXELS)
    assert (seen.image, seen.camera_name) == (folder / "images/a.png", "a")


@pytest.mark.parametrize(
    ("version", "keys"),
    [
        ((1, 2, 0), {"pxFocalLength": (40, 44), "principalPoint": (W / 2 + 1.5, H / 2 - 2.5)}),
        ((1, 2, 1), {"pxFocalLength": (40, 44), "principalPoint": (1.5, -2.5)}),
        ((1, 2, 2), {"focalLength": 20, "pixelRatio": 40 / 44}),
        ((1, 2, 5), {"focalLength": 20, "pixelRatio": 44 / 40}),
        ((1, 2, 10), {"focalLength": 20, "pixelRatio": 44 / 40}),
        ((1, 2, 11), {"focalLength": 22, "pixelRatio": 44 / 40}),
    ],
)
def test_focal_lengths_are_those_of_the_version_of_the_file(folder, version, keys):
    lay(folder, sfm(version, intrinsics=[lens(**keys)]))
    found = only_view(folder).camera.lens
    np.testing.assert_allclose(found.focal, (40, 44), rtol=1e-6)
    np.testing.assert_allclose(found.center, (W / 2 + 2, H / 2 - 2), rtol=1e-6)


def test_a_lens_without_distortion_may_have_zeros(folder):
    lay(folder, sfm(intrinsics=[lens(k=[0, "0.0"])]))
    np.testing.assert_allclose(only_view(folder).camera.lens.focal, 50)
    lay_numbers(folder, sfm(intrinsics=[lens(k=[0])]))
    np.testing.assert_allclose(only_view(folder).camera.lens.focal, 50)


@pytest.mark.parametrize(("version", "focal"), [((1, 2, 10), 25 * 48 / 32), ((1, 2, 11), 50)])
def test_the_sensor_of_a_portrait_is_as_wide_as_the_version_says(folder, version, focal):
    write_picture(folder / "images/a.png", H, W)
    lay(folder, sfm(version, intrinsics=[lens(width=H, height=W)]))
    np.testing.assert_allclose(only_view(folder).camera.lens.focal, focal, rtol=1e-6)


def test_points_are_given_with_their_colours(folder):
    point = {"landmarkId": 0, "color": (255, 0, 255), "X": (1, -2.5, 3), "observations": ()}
    lay(folder, sfm(structure=[point]))
    with pytest.warns(CaptureWarning, match="are found"):
        points = open_capture(folder).points
    np.testing.assert_allclose(points.position, [[1, -2.5, 3]])
    np.testing.assert_allclose(points.color, [[1, 0, 1]])
    for key, wrong in (("X", (1, 2)), ("X", (1, 2, "nan")), ("color", (0, 0, 256)), ("X", "")):
        lay(folder, sfm(structure=[point, {**point, key: wrong}]))
        with pytest.raises(CaptureError, match="point 1: structure: "):
            read_alicevision(folder)


def test_a_view_of_a_rig_is_at_its_place_in_it(folder):
    inner = Rotation.from_rotvec([0, 0.4, 0]).as_matrix(), np.array([0.1, 0, 0])
    rig = {"rigId": 3, "subPoses": [
        {"status": "estimated", "pose": transform(np.eye(3), np.zeros(3))},
        {"status": "constant", "pose": transform(*inner)},
        {"status": "uninitialized", "pose": transform(*inner)},
    ]}  # fmt: skip
    own = {"rigId": 3, "isPoseIndependant": "false"}
    lay(folder, sfm(views=[view(subPoseId=1, **own)], rigs=[rig]))
    seen = only_view(folder)
    turn, place = TURN @ inner[0], PLACE + TURN @ inner[1]
    world, seen_from = seen_points(turn, place)
    expected = 50 * distorted(seen_from) + (W / 2 + 2, H / 2 - 2)
    np.testing.assert_allclose(pixels(seen, world), expected, atol=PIXELS)
    for more, says in (
        ({"subPoseId": 3, **own}, "subPoseId must be below the 3 poses of its rig, got '?3"),
        ({"subPoseId": 0, **own, "rigId": 4}, "rigId must be that of one of the rigs, got '4'"),
        ({"subPoseId": 2, **own}, "must have a pose, got none of 1"),
    ):
        lay(folder, sfm(views=[view(**more)], rigs=[rig]))
        with pytest.raises(CaptureError, match=says):
            read_alicevision(folder)


def test_views_without_pose_are_counted_and_left_out(folder):
    views = [view(path="images/a.png"), view(2, "a/b.png"), view(3, "a/c.png")]
    lay(folder, sfm(views=views))
    with pytest.warns(CaptureWarning, match="2 of 3 pictures have no pose: left out"):
        assert len(read_alicevision(folder).views) == 1
    lay(folder, sfm(poses=""))
    with pytest.raises(CaptureError, match="got none of 1. .* after structure from motion"):
        open_capture(folder)


@pytest.mark.parametrize(
    ("made", "says"),
    [
        (sfm(intrinsics=[lens("fisheye1", [1])]), "view 0: lens of /home.*: distortionType must be "
         "one of none, .* got 'fisheye1'. Undistort the pictures in Meshroom .*exportColmap"),
        (sfm(intrinsics=[lens(type="equidistant")]), "type must be one of pinhole, got 'equidis"),
        (sfm(intrinsics=[lens(undistortionType="3declassicld")]), "undistortionType must be one"),
        (sfm(OLD, intrinsics=[old_lens("equidistant_r3")]), "type must be one of pinhole, radial1"),
        (sfm(intrinsics=[lens(focalLength="nan")]), "focalLength must be a finite number"),
        (sfm(intrinsics=[lens(focalLength=-1)]), "focalLength must be above 0"),
        (sfm(intrinsics=[lens(sensorWidth=0)]), "sensorWidth must be above 0, got 0.0"),
        (sfm(intrinsics=[lens(pixelRatio=0)]), "pixelRatio must be above 0, got 0.0"),
        (sfm(intrinsics=[lens(width="wide")]), "width must be a whole number"),
        (sfm(intrinsics=[lens("radialk3", [1, 2])]), "distortionParams must be a list of 3 finite"),
        (sfm(intrinsics=[lens(principalPoint=[1])]), "principalPoint must be a list of 2 finite"),
        (sfm(intrinsics=""), "view 0: intrinsicId must be that of one of the intrinsics, got '7'"),
        (sfm(intrinsics=[3]), "intrinsic 0: intrinsics must be a list of blocks, got '3'"),
        (sfm(views="many"), "views must be a list, got 'many'"),
        (sfm(views=[view(path="")]), "view 0: path must be a text"),
        (sfm(poses=[{"poseId": 1}]), "pose 0: pose must be a block of keys, got nothing"),
        (sfm(poses=[posed(turn=2 * TURN)]), "pose 0: pose.transform.rotation must be a rotation"),
        (sfm(poses=[posed(turn=-TURN)]), "right-handed"),
        (sfm(poses=[posed(place=[1, "inf", 0])]), "pose.transform.center must be a list of 3 fin"),
        (sfm(version="new"), "version must be three whole numbers, got 'new'"),
        (sfm(version=(1, 2, 9.5)), "version must be three whole numbers"),
        (sfm(version=(1, 2, "1e999")), "version must be three whole numbers"),
        (sfm(intrinsics=[lens(k=[0, 1])]), "distortionParams must be zeros or absent, .* got .0.0"),
        (sfm(intrinsics=[lens(k="x")]), "distortionParams must be zeros or absent, .* got 'x'"),
        (sfm(views=[view(), view(2)], poses=[posed(), posed(2)]), "got images/a.png 2 times"),
    ],
)  # fmt: skip
@pytest.mark.filterwarnings("ignore::gaussray.capture.errors.CaptureWarning")
def test_what_contradicts_the_format_is_refused_by_name(folder, made, says):
    lay(folder, made)
    with pytest.raises(CaptureError, match=says) as caught:
        read_alicevision(folder)
    assert str(caught.value).startswith(str(folder / "cameras.sfm"))


@pytest.mark.parametrize(
    ("made", "says"),
    [
        (sfm(version=(1, 2, np.inf)), r"version must be three whole numbers, got \[1, 2, inf\]"),
        (sfm(version=(1, 2, np.nan)), "version must be three whole numbers"),
        (sfm(version=(1, 2, 10**399)), "version must be three whole numbers"),
        (sfm(version=(1, 2, True)), "version must be three whole numbers"),
        (sfm(intrinsics=[lens(width=True)]), "width must be a whole number of .* got True"),
        (sfm(intrinsics=[lens(focalLength=True)]), "focalLength must be a finite number, got True"),
        (sfm(intrinsics=[lens(k=[False])]), "distortionParams must be zeros or absent"),
        (sfm(poses=[posed(place=[True, 0, 0])]), "center must be a list of 3 finite numbers"),
    ],
)
def test_what_is_no_number_is_refused_by_name(folder, made, says):
    lay_numbers(folder, made)
    with pytest.raises(CaptureError, match=says) as caught:
        read_alicevision(folder)
    assert str(caught.value).startswith(str(folder / "cameras.sfm"))


def test_of_several_projects_the_result_of_structure_from_motion_is_read(folder):
    first, second = view(path="images/a.png"), view(2, "images/b.png")
    both = sfm(views=[first, second], poses=[posed(), posed(2)])
    lay(folder, sfm(poses=""), "cameraInit.sfm")
    lay(folder, both, "others.sfm")
    lay(folder, sfm(views=[first]))
    with pytest.warns(CaptureWarning, match="of 3 projects this one is read, and .*others.sfm is"):
        assert len(open_capture(folder).views) == 1
    (folder / "cameras.sfm").unlink()
    with pytest.warns(CaptureWarning, match="others.sfm: of 2 projects"):
        assert len(open_capture(folder).views) == 2


def test_the_project_of_meshroom_is_its_cache(folder):
    inside = [view(path=str(folder / "images/a.png"))]
    lay(folder, sfm(views=inside), "MeshroomCache/StructureFromMotion/0f/cameras.sfm")
    (found,) = open_capture(folder).views
    assert found.image == folder / "images/a.png"
    with pytest.raises(FileNotFoundError, match="holds no project of AliceVision"):
        read_alicevision(folder / "images")


def test_a_model_of_colmap_is_read_before_it(folder):
    lay(folder, sfm())
    (folder / "sparse/0").mkdir(parents=True)
    (folder / "sparse/0/cameras.txt").write_text("1 PINHOLE 64 48 50 50 32 24\n")
    (folder / "sparse/0/images.txt").write_text("1 1 0 0 0 0 0 0 1 a.png\n\n")
    assert format_of(folder) == "colmap"
