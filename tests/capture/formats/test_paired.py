"""A capture's JSON becomes cameras, or an error that says where it stands and what to do."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gaussray.camera.camera import camera_ray
from gaussray.camera.lens import FisheyePolynomial, KannalaBrandt, Pinhole, ThinPrismFisheye
from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.formats.paired import effect_files, read_capture, read_views


CENTER = jnp.full(5, 0.5)
# Turned by a third about (1, 1, 1): x -> y -> z -> x, so no axis stands for itself.
POSE = [[0, 0, 1, 1.5], [1, 0, 0, -2.0], [0, 1, 0, 0.25], [0, 0, 0, 1]]
FISHEYE = {
    "model": "blender_fisheye_polynomial",
    "k": [0.0, -0.0745, -1.5e-4, -2.5e-5, 2.0e-7],
    "sensor_width_mm": 36.0,
    "sensor_height_mm": 36.0,
    "fov": 2.9,
    "shift": [0.0, 0.0],
}
APERTURE = {
    "radius": 0.09,
    "focus_distance": 2.3,
    "focus": "sphere",
    "blades": 5,
    "rotation": 0.3,
    "ratio": 1.5,
}
SHUTTER = {"row_offset": -0.1, "row_step": 0.002, "exposure": 0.01, "direction": "bottom_to_top"}


def document(**changes):
    """A capture of one frame; `frame` overrides its keys, a value of ... removes a key."""
    frame = {
        "file_path": "images/cam03/0012.png",
        "transform_matrix": POSE,
        "time": 0.24,
        "camera": "cam03",
        "split": "train",
    }
    top = {"w": 64, "h": 48, "fl_x": 50.0, "fl_y": 55.0, "cx": 32.5, "cy": 23.0}
    frame |= changes.pop("frame", {})
    top |= {"camera_model": "PINHOLE", **changes, "frames": [frame]}
    for block in (top, frame):
        for key in [key for key, value in block.items() if value is ...]:
            del block[key]
    return top


def write(path, content):
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def read(folder, content=None, **changes):
    content = document(**changes) if content is None else content
    return read_views(write(folder / "transforms.json", content), jnp.float64)


def test_a_pinhole_pixel_looks_along_blenders_formula(tmp_path):
    (view,) = read(tmp_path)
    column, row = 10.0, 40.0
    ray = jax.jit(camera_ray)(view.camera, jnp.array([column, row]), CENTER)
    ours = np.array([(column + 0.5 - 32.5) / 50, -(row + 0.5 - 23) / 55, -1])
    expected = np.array(POSE)[:3, :3] @ (ours / np.linalg.norm(ours))
    np.testing.assert_allclose(ray.direction, expected, atol=1e-12)
    np.testing.assert_allclose(ray.origin, [1.5, -2, 0.25], atol=1e-12)
    assert ray.time == pytest.approx(0.24)


def test_a_view_carries_what_its_frame_says(tmp_path):
    frame = {"mask_path": "m.png", "depth_file_path": "d.exr", "split": "test"}
    (view,) = read(tmp_path, frame=frame, samples=64, color_space="linear")
    assert view.image == tmp_path / "images/cam03/0012.png"
    assert (view.mask, view.depth) == (tmp_path / "m.png", tmp_path / "d.exr")
    assert (view.camera_name, view.split, view.time) == ("cam03", "test", 0.24)
    assert (view.effect, view.samples, view.color_space) == ("pinhole", 64, "linear")
    assert (view.width, view.height) == (64, 48)
    assert isinstance(view.camera.lens, Pinhole) and not view.camera.lens.distorted


def test_the_type_of_number_is_the_callers(tmp_path):
    path = write(tmp_path / "transforms.json", document(aperture=APERTURE, lens=FISHEYE))
    for kind in (jnp.float32, jnp.float64):
        (view,) = read_views(path, kind)
        assert {leaf.dtype for leaf in jax.tree.leaves(view.camera)} == {jnp.dtype(kind)}
    leaves = jax.tree.leaves(read_views(path)[0].camera)
    assert {leaf.dtype for leaf in leaves} == {jnp.dtype(jnp.float32)}


def test_opencv_coefficients_keep_opencvs_order(tmp_path):
    k = {"k1": 0.1, "k2": -0.02, "p1": 1e-3, "p2": -2e-3, "k3": 5e-3}
    (view,) = read(tmp_path, camera_model="OPENCV", **k)
    np.testing.assert_array_equal(
        view.camera.lens.distortion, [0.1, -0.02, 1e-3, -2e-3, 5e-3, 0, 0, 0]
    )


def test_an_opencv_fisheye_reaches_as_far_as_its_polynomial_rises(tmp_path):
    (view,) = read(tmp_path, camera_model="OPENCV_FISHEYE")
    lens = view.camera.lens
    assert isinstance(lens, KannalaBrandt) and view.effect == "fisheye"
    assert float(lens.max_angle) == pytest.approx(np.pi, rel=1e-3)
    # theta - 0.1 theta^3 rises up to sqrt(10/3).
    (view,) = read(tmp_path, camera_model="OPENCV_FISHEYE", k1=-0.1)
    assert float(view.camera.lens.max_angle) == pytest.approx(np.sqrt(10 / 3), rel=2e-3)
    block = {"model": "kannala_brandt", "fov": 2.5}
    (view,) = read(tmp_path, camera_model="OPENCV_FISHEYE", k1=-0.1, lens=block)
    assert float(view.camera.lens.max_angle) == 1.25


def test_a_sphere_is_nerfstudios(tmp_path):
    """Its cameras.py: theta = -pi x, phi = pi (1/2 - y), x and y in focal lengths, y upwards."""
    keys = {"fl_x": 32, "fl_y": 48, "cx": 32, "cy": 24}
    (view,) = read(tmp_path, camera_model="EQUIRECTANGULAR", **keys)
    assert view.effect == "equirectangular"
    for column, row in ((10.0, 40.0), (60.0, 3.0)):
        ray = jax.jit(camera_ray)(view.camera, jnp.array([column, row]), CENTER)
        x, y = (column + 0.5 - 32) / 32, -(row + 0.5 - 24) / 48
        theta, phi = -np.pi * x, np.pi * (0.5 - y)
        ours = [-np.sin(theta) * np.sin(phi), np.cos(phi), -np.cos(theta) * np.sin(phi)]
        np.testing.assert_allclose(ray.direction, np.array(POSE)[:3, :3] @ ours, atol=1e-12)


def test_a_thin_prism_fisheye_reaches_as_far_as_its_polynomial_rises(tmp_path):
    (view,) = read(tmp_path, camera_model="THIN_PRISM_FISHEYE", k1=-0.1, s1=0.01, p2=1e-3)
    lens = view.camera.lens
    assert isinstance(lens, ThinPrismFisheye) and view.effect == "fisheye"
    np.testing.assert_array_equal(lens.coefficients, [-0.1, 0, 0, 1e-3, 0, 0, 0.01, 0])
    assert float(lens.max_angle) == pytest.approx(np.sqrt(10 / 3), rel=2e-3)


def test_all_effects_together_are_one_camera(tmp_path):
    blocks = {"lens": FISHEYE, "aperture": APERTURE, "shutter": SHUTTER}
    (view,) = read(tmp_path, **blocks)
    camera = view.camera
    assert isinstance(camera.lens, FisheyePolynomial)
    np.testing.assert_array_equal(camera.lens.coefficients, FISHEYE["k"])
    np.testing.assert_array_equal(camera.lens.resolution, [64, 48])
    assert (camera.aperture.focus, camera.aperture.blades) == ("sphere", 5)
    assert float(camera.aperture.ratio) == 1.5
    assert camera.shutter.direction == "bottom_to_top" and float(camera.shutter.exposure) == 0.01
    assert view.effect == "fisheye+depth_of_field+rolling_shutter"


def test_a_frame_overrides_the_top_level_and_null_switches_off(tmp_path):
    frame = {"aperture": None, "shutter": {"row_step": 0.5}, "w": 32, "effect": "mine"}
    (view,) = read(tmp_path, aperture=APERTURE, shutter=SHUTTER, frame=frame)
    assert float(view.camera.aperture.radius) == 0
    assert float(view.camera.shutter.row_step) == 0.5
    assert float(view.camera.shutter.row_offset) == 0
    assert (view.width, view.effect) == (32, "mine")


def test_a_trajectory_moves_the_camera_within_the_frame(tmp_path):
    moved = np.array(POSE)
    moved[0, 3] += 2
    path = [
        {"time": 0.0, "transform_matrix": POSE},
        {"time": 1.0, "transform_matrix": moved.tolist()},
    ]
    (view,) = read(tmp_path, frame={"trajectory": path, "transform_matrix": ...})
    ray = jax.jit(camera_ray)(view.camera, jnp.array([0.0, 0.0]), CENTER)
    np.testing.assert_allclose(ray.origin, [1.5 + 0.24 * 2, -2, 0.25], atol=1e-12)


def test_focus_at_infinity_is_a_word(tmp_path):
    (view,) = read(tmp_path, aperture={"radius": 0.1, "focus_distance": "infinity"})
    assert jnp.isinf(view.camera.aperture.focus_distance)


def test_a_pixel_filter_may_be_named(tmp_path):
    (view,) = read(tmp_path, film={"filter": "box", "filter_width": 1.0})
    assert (view.camera.film.filter, view.camera.film.filter_width) == ("box", 1.0)


def test_nerfstudios_own_keys_pass_without_a_word(tmp_path):
    read(tmp_path, aabb_scale=16, camera_angle_x=0.7, applied_scale=1.0, info={"any": "thing"})


def test_an_unknown_key_is_warned_of_with_file_frame_and_name(tmp_path):
    with pytest.warns(CaptureWarning, match="transforms.json: the key colour_space is unknown"):
        read(tmp_path, colour_space="srgb")
    with pytest.warns(CaptureWarning, match="transforms.json, frame 0: the key tiem is unknown"):
        read(tmp_path, frame={"tiem": 0.5})
    with pytest.warns(CaptureWarning, match="frame 0: the key aperture.fstop is unknown.*radius"):
        read(tmp_path, aperture={**APERTURE, "fstop": 2.8})


def test_an_unknown_key_of_many_frames_is_one_warning(tmp_path):
    content = document(frame={"tiem": 0.5})
    content["frames"] *= 3
    with pytest.warns(CaptureWarning) as caught:
        read(tmp_path, content)
    assert len(caught) == 1 and "tiem is unknown and ignored (and in 2 more" in str(
        caught[0].message
    )


def test_a_capture_without_times_is_static_with_a_warning(tmp_path):
    with pytest.warns(CaptureWarning, match="no frame has a time: the capture is taken as static"):
        (view,) = read(tmp_path, frame={"time": ...})
    assert view.time == 0


def test_a_capture_that_says_it_is_static_is_not_warned_of(tmp_path):
    (view,) = read(tmp_path, static=True, frame={"time": ...})
    assert view.time == 0


def test_a_missing_split_is_train_with_a_warning_and_the_folder_names_the_camera(tmp_path):
    with pytest.warns(CaptureWarning) as caught:
        (view,) = read(tmp_path, frame={"camera": ..., "split": ...})
    assert (view.camera_name, view.split) == ("cam03", "train")
    assert len(caught) == 1
    assert "have no split: each is taken as train" in str(caught[0].message)


def test_nerfstudios_lists_name_the_held_out_frames(tmp_path):
    (view,) = read(tmp_path, test_filenames=["images/cam03/0012.png"], frame={"split": ...})
    assert view.split == "test"


def test_an_axis_beside_the_centre_is_not_ignored_in_silence_by_a_fisheye(tmp_path):
    with pytest.warns(CaptureWarning, match="the key cx is ignored.*Write lens.shift"):
        read(tmp_path, lens={**FISHEYE, "shift": None}, cy=24)
    (view,) = read(tmp_path, lens={**FISHEYE, "shift": [0.01, 0.02]})
    np.testing.assert_array_equal(view.camera.lens.shift, [0.01, 0.02])


def skewed(scale):
    return (np.array(POSE) @ np.diag([*scale, 1])).tolist()


WRONG = [
    ({"w": ...}, "transforms.json, frame 0: w must be a whole number of at least 1, got nothing"),
    ({"w": 64.5}, "w must be a whole number of at least 1, got 64.5"),
    ({"h": 0}, "h must be a whole number of at least 1, got 0"),
    ({"h": True}, "h must be a whole number"),
    ({"fl_x": ...}, "fl_x must be a number, got nothing. It is required"),
    ({"fl_y": "55"}, "fl_y must be a finite number, got '55'"),
    ({"fl_y": -55}, r"transforms.json, frame 0: lens.focal must be above 0, got \[50.0, -55.0\]"),
    ({"cx": float("nan")}, "cx must be a finite number, got nan"),
    ({"camera_model": "ORTHOPHOTO"}, "camera_model must be one of .*PINHOLE, .*'ORTHOPHOTO'"),
    ({"camera_model": "EQUIRECTANGULAR", "fl_x": 20}, "lens.focal must give every pixel a dir"),
    ({"camera_model": "OPENCV", "k1": -3.0}, "lens.distortion must give every pixel a direction"),
    ({"color_space": "aces"}, "color_space must be one of srgb, linear, got 'aces'"),
    ({"samples": -1}, "samples must be a whole number of at least 1, got -1"),
    ({"lens": {**FISHEYE, "model": "anamorph"}}, "lens.model must be one of blender_f.*'anamorph"),
    ({"lens": {"model": "f_theta", "k": [0, 1]}}, "lens.polynomial must be one of angle_of_radius"),
    (
        {"lens": {"model": "f_theta", "polynomial": "angle_of_radius", "k": [], "fov": 2}},
        r"lens.k must be a list of 1 finite numbers, got \[\]",
    ),
    (
        {"lens": {"model": "f_theta", "polynomial": "angle_of_radius", "k": [0, 1, -9], "fov": 2}},
        "transforms.json, frame 0: lens.k must reach half of lens.fov",
    ),
    ({"lens": {"model": "double_sphere", "k": [0, 0.6]}}, "lens.fov must be a number, got nothing"),
    (
        {"lens": {"model": "double_sphere", "k": [0, 2], "fov": 3}},
        "lens.k .alpha. must be in .0, 1",
    ),
    ({"lens": {"model": "unified_sphere", "k": [0.2], "fov": 6}}, "lens.k must be monotone"),
    ({"lens": {"model": "orthographic", "fov": 4}}, "lens.max_angle must be in .0, 1.570796. here"),
    ({"lens": {"model": "table"}}, "lens.file must be a table of directions"),
    ({"lens": {**FISHEYE, "k": [0, -0.07]}}, "lens.k must be a list of 5 finite numbers"),
    ({"lens": "fisheye"}, "lens must be a block with the keys model, k, .*, got 'fisheye'"),
    (
        {"lens": {**FISHEYE, "k": [0, -0.1, 0.005, 0, 0]}},
        "transforms.json, frame 0: lens.k must be monotone",
    ),
    (
        {"aperture": {**APERTURE, "radius": -0.1}},
        "transforms.json, frame 0: aperture.radius must be at least 0, got -0.1",
    ),
    ({"aperture": {"radius": 0.1}}, "aperture.focus_distance must be a number, got nothing"),
    ({"aperture": {**APERTURE, "focus": "cube"}}, "aperture.focus must be one of plane, sphere"),
    ({"aperture": {**APERTURE, "blades": -2}}, "aperture.blades must be a whole number of at"),
    ({"shutter": {**SHUTTER, "exposure": -1}}, "shutter.exposure must be at least 0, got -1"),
    ({"shutter": {**SHUTTER, "direction": "up"}}, "shutter.direction must be one of top_to"),
    ({"film": {"filter": "mitchell"}}, "film.filter must be one of box"),
    ({"frame": {"file_path": ...}}, "frame 0: file_path must be a text, got nothing"),
    ({"frame": {"split": "val"}}, "split must be one of train, test, got 'val'"),
    ({"frame": {"time": "0.5"}}, "frame 0: time must be a finite number, got '0.5'"),
    ({"frame": {"transform_matrix": ...}}, "transform_matrix must be a rigid 4x4 .*got nothing"),
    ({"frame": {"transform_matrix": [[1, 2], [3]]}}, "Write four rows of four numbers"),
    ({"frame": {"transform_matrix": np.eye(4)[::-1].tolist()}}, "last row 0 0 0 1"),
    ({"frame": {"transform_matrix": skewed([2, 2, 2])}}, "without scale.*Divide.*columns by 2 "),
    ({"frame": {"transform_matrix": skewed([1, 1, 1.1])}}, "without shear or unequal scale"),
    ({"frame": {"transform_matrix": skewed([1, 1, -1])}}, "without reflection.*determinant"),
    ({"frame": {"transform_matrix": skewed([0, 0, 0])}}, "without scale|shear"),
    (
        {"frame": {"transform_matrix": skewed([1, 1, float("nan")])}},
        "frame 0: transform_matrix must be finite, got .*nan.*Remove the frame",
    ),
    ({"frame": {"trajectory": []}}, "trajectory must be a list of at least one"),
    ({"frame": {"trajectory": [{"time": 0}]}}, r"trajectory\[0\].transform_matrix must be a rigid"),
    (
        {"frame": {"trajectory": [{"time": 0, "transform_matrix": POSE}] * 2}},
        "frame 0: trajectory.time must be finite and strictly increasing",
    ),
    ({"frames": []}, "frames must be a list of at least one frame"),
]


@pytest.mark.parametrize(("changes", "says"), WRONG, ids=[str(k) for k in range(len(WRONG))])
def test_every_wrong_value_is_named_with_its_place_and_rule(tmp_path, changes, says):
    content = document(**changes)
    if "frames" in changes:
        content["frames"] = changes["frames"]
    with pytest.raises(CaptureError, match=f"(?s){says}"):
        read(tmp_path, content)


def test_one_frame_without_time_among_timed_ones_is_an_error(tmp_path):
    content = document()
    content["frames"].append({k: v for k, v in content["frames"][0].items() if k != "time"})
    with pytest.raises(CaptureError, match="frame 1: time must be a number, got nothing. Give"):
        read(tmp_path, content)


def test_malformed_json_says_line_and_column(tmp_path):
    with pytest.raises(CaptureError, match=r"transforms.json: malformed JSON at line 2, column 9"):
        read(tmp_path, '{"w": 64,\n "h": 4,, "frames": []}')
    with pytest.raises(CaptureError, match="must hold one JSON object, got list"):
        read(tmp_path, "[1, 2]")
    (tmp_path / "bad.json").write_bytes(b'{"w": "\xff"}')
    with pytest.raises(CaptureError, match="bad.json: the file must be UTF-8"):
        read_views(tmp_path / "bad.json")


def test_a_missing_file_or_folder_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="none.json: the capture's JSON file does not"):
        read_views(tmp_path / "none.json")
    with pytest.raises(FileNotFoundError, match="none: the capture folder does not exist"):
        read_capture(tmp_path / "none")
    with pytest.raises(CaptureError, match="must hold transforms.json .* got none"):
        read_capture(tmp_path)


def test_a_capture_is_its_pinhole_views_its_effects_and_its_points(tmp_path):
    content = document()
    content["frames"].append({**content["frames"][0], "time": 0.9})
    write(tmp_path / "transforms.json", content)
    write(tmp_path / "a.json", document(effect="depth_of_field", aperture=APERTURE))
    write(tmp_path / "rolling_shutter.json", document(shutter=SHUTTER))
    write(tmp_path / "report.json", {"psnr": 30})
    (tmp_path / "points3d.ply").write_bytes(
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
        b"property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n"
        b"end_header\n1 2 3 255 0 0\n"
    )
    assert list(effect_files(tmp_path)) == ["pinhole", "depth_of_field", "rolling_shutter"]
    capture = read_capture(tmp_path, jnp.float64)
    assert len(capture.views) == 2 and capture.time_range == (0.24, 0.9)
    assert list(capture.effects) == ["depth_of_field", "rolling_shutter"]
    assert capture.effects["depth_of_field"][0].effect == "depth_of_field"
    np.testing.assert_array_equal(capture.points.position, [[1, 2, 3]])
    assert capture.time_unit == "normalised"


def test_points_are_optional_and_missing_ones_are_warned_of(tmp_path):
    write(tmp_path / "transforms.json", document())
    assert read_capture(tmp_path).points is None
    write(tmp_path / "transforms.json", document(ply_file_path="start.ply"))
    with pytest.warns(CaptureWarning, match="start.ply, which does not exist"):
        assert read_capture(tmp_path).points is None


def test_two_files_of_one_effect_are_not_merged_in_silence(tmp_path):
    write(tmp_path / "a.json", document(effect="fisheye"))
    write(tmp_path / "fisheye.json", document())
    with pytest.raises(CaptureError, match="fisheye.json: effect must be unique.*a.json has too"):
        effect_files(tmp_path)


def test_a_folder_of_effects_alone_is_a_capture(tmp_path):
    write(tmp_path / "fisheye.json", document(lens=FISHEYE))
    capture = read_capture(tmp_path)
    assert capture.views == [] and list(capture.effects) == ["fisheye"]
    assert capture.time_range == (0.24, 0.24)
