"""Photographs with the cameras of OpenMVG."""

import json

import numpy as np
import pytest
from known_photograph import (
    PIXELS,
    PLACE,
    TO_CAMERA,
    H,
    W,
    distorted,
    fisheye,
    pixels,
    seen_points,
    sphere,
    write_picture,
)

from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.formats.openmvg import read_openmvg
from gaussray.capture.open import format_of, open_capture


BROWN = {"k1": -0.1, "k2": 0.05, "k3": -0.02, "p1": 0.003, "p2": -0.002}
BASE = {"width": W, "height": H, "focal_length": 50, "principal_point": [33.5, 22]}
FIRST = 2147483648


def entry(key, value):
    return {"key": key, "value": value}


def held(data, number, name=None):
    """A block of a type, which has a name where it is the first of it."""
    named = {"polymorphic_name": name} if name else {}
    number = number | FIRST if name else number
    return {"polymorphic_id": number, **named, "ptr_wrapper": {"id": 1, "data": data}}


def view(key=0, name="a.png", lens=0, **more):
    names = {"local_path": "", "filename": name, "width": W, "height": H, "id_view": key}
    return entry(key, held({**names, "id_intrinsic": lens, "id_pose": key, **more}, 1 << 30))


def pose(key=0, rotation=TO_CAMERA, center=PLACE):
    return entry(key, {"rotation": np.asarray(rotation).tolist(), "center": list(center)})


def lens(kind="pinhole", key=0, **more):
    return entry(key, held({**BASE, **more}, 1, kind))


def sfm(**more):
    base = {"sfm_data_version": "0.3", "root_path": "/home/someone/images", "views": [view()]}
    base |= {"intrinsics": [lens()], "extrinsics": [pose()], "structure": []}
    return {**base, "control_points": [], **more}


def lay(folder, content, name="sfm_data.json"):
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(json.dumps(content))


@pytest.fixture
def folder(tmp_path):
    for name in ("a", "b"):
        write_picture(tmp_path / "images" / f"{name}.png")
    return tmp_path


def views_of_folder(folder):
    with pytest.warns(CaptureWarning, match="are found if its beginning home/someone/ is left"):
        return open_capture(folder).views


@pytest.mark.parametrize(
    ("made", "image"),
    [
        (lens(), distorted),
        (lens("pinhole_radial_k1", disto_k1=[-0.1]), lambda own: distorted(own, -0.1)),
        (lens("pinhole_radial_k3", disto_k3=[-0.1, 0.05, 0.02]),
         lambda own: distorted(own, -0.1, 0.05, 0.02)),
        (lens("pinhole_brown_t2", disto_t2=list(BROWN.values())),
         lambda own: distorted(own, **BROWN)),
        (lens("fisheye", fisheye=[0.02, -0.01, 3e-3, -1e-3]),
         lambda own: fisheye(own, 0.02, -0.01, 3e-3, -1e-3)),
    ],
)  # fmt: skip
def test_a_point_falls_where_openmvg_puts_it(folder, made, image):
    lay(folder, sfm(intrinsics=[made]))
    assert format_of(folder) == "openmvg"
    (seen,) = views_of_folder(folder)
    world, own = seen_points()
    # The middle of the first pixel is 0 there, 0.5 here.
    expected = 50 * image(own) + (33.5 + 0.5, 22 + 0.5)
    np.testing.assert_allclose(pixels(seen, world), expected, atol=PIXELS)
    assert (seen.image, seen.camera_name) == (folder / "images/a.png", "a")


def test_a_sphere_has_what_is_ahead_in_its_middle(folder):
    write_picture(folder / "images/a.png", W, W // 2)
    size = {"value0": {"width": W, "height": W // 2}}
    lay(folder, sfm(intrinsics=[entry(0, held(size, 1, "spherical"))]))
    (seen,) = views_of_folder(folder)
    world, own = seen_points()
    expected = W * sphere(own) + (W / 2, W / 4)
    np.testing.assert_allclose(pixels(seen, world), expected, atol=PIXELS)


def test_a_type_is_named_where_it_is_first_and_numbered_after(folder):
    # A view of another type (view_priors) takes the first number.
    prior = view(name="a.png", lens=5)
    prior["value"] |= {"polymorphic_id": FIRST | 1, "polymorphic_name": "view_priors"}
    kind = "pinhole_radial_k1"
    first = entry(4, held({**BASE, "disto_k1": [-0.1]}, 2, kind))
    second = entry(5, held({**BASE, "focal_length": 60, "disto_k1": [-0.2]}, 2))
    extrinsics, views = [pose(), pose(1)], [prior, view(1, "b.png", lens=4)]
    lay(folder, sfm(intrinsics=[first, second], views=views, extrinsics=extrinsics))
    found = [seen.camera.lens for seen in views_of_folder(folder)]
    np.testing.assert_allclose([x.focal[0] for x in found], [60, 50])
    np.testing.assert_allclose([x.distortion[0] for x in found], [-0.2, -0.1], rtol=1e-6)


def test_views_of_old_files_have_no_type(folder):
    old = view()
    del old["value"]["polymorphic_id"]
    old["value"]["ptr_wrapper"]["data"]["local_path"] = "/"
    lay(folder, sfm(sfm_data_version="0.2", views=[old]))
    (seen,) = views_of_folder(folder)
    assert seen.image == folder / "images/a.png"


def test_points_are_given_in_gray(folder):
    point = entry(7, {"X": [1, -2.5, 3], "observations": []})
    lay(folder, sfm(structure=[point], root_path="images"))
    with pytest.warns(CaptureWarning, match="its points have no colour; all are gray 0.5"):
        points = open_capture(folder).points
    np.testing.assert_allclose(points.position, [[1, -2.5, 3]])
    np.testing.assert_allclose(points.color, [[0.5, 0.5, 0.5]])


def test_views_without_pose_are_counted_and_left_out(folder):
    none = 4294967295
    views = [view(), view(1, "b.png"), view(2, "c.png", id_pose=none, lens=none)]
    lay(folder, sfm(views=views, root_path="images"))
    with pytest.warns(CaptureWarning, match="2 of 3 pictures have no pose: left out"):
        assert len(read_openmvg(folder).views) == 1


def test_the_project_with_poses_is_read_of_those_in_folders(folder):
    lay(folder, sfm(extrinsics=[]), "matches/sfm_data.json")
    with pytest.raises(CaptureError, match="matches/sfm_data.json: at least one picture must have"):
        open_capture(folder)
    lay(folder, sfm(root_path="images"), "reconstruction/sfm_data.json")
    with pytest.warns(CaptureWarning, match="reconstruction/sfm_data.json: of 2 projects this one"):
        (seen,) = open_capture(folder).views
    assert seen.image == folder / "images/a.png"


def test_pictures_outside_of_the_folder_tell_how_they_are_used(folder):
    lay(folder / "project", sfm(root_path=str(folder / "images")))
    with pytest.raises(CaptureError, match="must name a file in .*limits.folders="):
        open_capture(folder / "project")


@pytest.mark.parametrize(
    ("made", "says"),
    [
        (sfm(intrinsics=[lens("pinhole_tilted")]), "view 0: lens of a.png: polymorphic_name must "
         "be one of pinhole, .* got 'pinhole_tilted'. Undistort .*in OpenMVG.*openMVG2Colmap"),
        (sfm(intrinsics=[entry(0, held(BASE, 1))]), "polymorphic_name must be .* got None"),
        (sfm(intrinsics=[lens("fisheye")]), "fisheye must be a list of 4 finite numbers"),
        (sfm(intrinsics=[lens(focal_length=0)]), "focal_length must be above 0, got 0"),
        (sfm(intrinsics=[lens(focal_length=float("nan"))]), "focal_length must be a finite"),
        (sfm(intrinsics=[lens(principal_point=[1])]), "principal_point must be a list of 2 finite"),
        (sfm(intrinsics=[lens(width=None)]), "lens of a.png: width must be a whole number"),
        (sfm(intrinsics=[lens(key=9)]), "view 0: id_intrinsic must be the key of one of the"),
        (sfm(intrinsics=[{"key": 0}]), "entry of intrinsics 0: value must be a block of keys"),
        (sfm(intrinsics={"a": 1}), "intrinsics must be a list"),
        (sfm(views=[entry(0, {"polymorphic_id": 1})]), "value.ptr_wrapper must be a block of keys"),
        (sfm(views=[view(filename="")]), "view 0: filename must be a text that is not empty"),
        (sfm(extrinsics=[]), "must have a pose, got none of 1"),
        (sfm(extrinsics=[pose(rotation=TO_CAMERA[:2])]), "value.rotation must be three rows"),
        (sfm(extrinsics=[pose(rotation=[[1, 0], [0, 1], [0, 0]])]), "must be a list of 3 finite"),
        (sfm(extrinsics=[pose(rotation=-TO_CAMERA)]), "value.rotation must be a rotation"),
        (sfm(extrinsics=[pose(rotation=1e300 * TO_CAMERA)]), "value.rotation must be a rotation"),
        (sfm(extrinsics=[pose(center=[0, 1])]), "value.center must be a list of 3 finite numbers"),
        (sfm(structure=[entry(0, {"X": [0, "a", 1]})]), "point 0: structure: position must be thr"),
    ],
)  # fmt: skip
@pytest.mark.filterwarnings("ignore::gaussray.capture.errors.CaptureWarning")
def test_what_contradicts_the_format_is_refused_by_name(folder, made, says):
    lay(folder, made)
    with pytest.raises(CaptureError, match=says) as caught:
        read_openmvg(folder)
    assert str(caught.value).startswith(str(folder / "sfm_data.json"))


def test_files_of_other_programs_are_none_of_openmvg(folder):
    for content in ('{"extrinsics": []}', "[1]", "{}"):
        (folder / "sfm_data.json").write_text(content)
        with pytest.raises(CaptureError, match="is no capture of a known format"):
            format_of(folder)
    with pytest.raises(FileNotFoundError, match="holds no sfm_data.json of OpenMVG"):
        read_openmvg(folder)
