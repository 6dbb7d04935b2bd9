"""Every option of the rig exchanges what it names and nothing else."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.camera.lens import FisheyePolynomial, KannalaBrandt, Pinhole
from gaussray.camera.lens.registry import models_by_name
from gaussray.camera.shutter import row_moments
from gaussray.camera.trajectory import pose_at
from gaussray.config.compose import compose_config
from gaussray.config.jobs import rig_options
from gaussray.config.options import build_options
from gaussray.config.schema import conf_folder
from gaussray.dataset.images import write_image
from gaussray.dataset.manifest import write_manifest
from gaussray.geometry import rotation_matrix
from gaussray.render.rig import rig
from gaussray.render.rig.film import apply_film
from gaussray.render.rig.placed import CAMERA_KINDS, placed_views
from gaussray.render.rig.used_keys import apply_implied_choices, check_used_keys
from gaussray.render.rig.view_files import load_views


look = jax.jit(jax.vmap(lambda lens, pixel: lens.direction(pixel), in_axes=(None, 0)))


def built(views, **groups):
    return rig.frame_records(views, options=rig.RigOptions(**groups), samples=3)


@pytest.mark.parametrize(
    ("options", "key", "value"),
    [
        (rig.ShutterOptions, "shutter.readout", np.inf),
        (rig.ShutterOptions, "shutter.exposure", np.inf),
        (rig.ShutterOptions, "shutter.row_step", -np.inf),
        (rig.ShutterOptions, "shutter.field_time", np.inf),
        (rig.ShutterOptions, "shutter.row_times", (0.0, np.inf)),
        (rig.ShutterOptions, "shutter.trigger", (np.inf,)),
        (rig.CameraOptions, "camera.times", (0.0, np.nan)),
    ],
)
def test_times_that_are_not_finite_are_refused_by_their_keys(options, key, value):
    with pytest.raises(ValueError, match=rf"{key} must be finite, got .* Give times in the"):
        options(**{key.split(".")[1]: value})


def test_keep_keeps_the_held_out_cameras(views):
    records = built(views)
    assert [r.camera_name for r in records] == ["cam_3"] * 3
    assert {(r.effect, r.samples, r.split) for r in records} == {("pinhole", 3, "test")}
    for record, view in zip(records, views[-3:], strict=True):
        assert record.camera.lens is view.camera.lens
        assert record.camera.shutter is view.camera.shutter
        assert record.camera.time == view.camera.time


def test_cameras_keep_where_they_begin_to_see_unless_the_key_says_where(views):
    clipped = [
        dataclasses.replace(v, camera=dataclasses.replace(v.camera, clip_start=toy.single(0.25)))
        for v in views
    ]
    for value, want in ((None, 0.25), (0.5, 0.5), (0.0, None)):
        records = built(clipped, camera=rig.CameraOptions(clip_start=value))
        assert {None if (x := r.camera.clip_start) is None else float(x) for r in records} == {want}
    two = rig.CameraOptions(names=("cam_0", "cam_1"))
    ride = built(clipped, camera=two, trajectory=rig.TrajectoryOptions("between", steps=3))
    assert {float(r.camera.clip_start) for r in ride} == {0.25}
    # A camera that is placed elsewhere stands in no camera's body.
    (placed,) = placed_views(toy.scene(), rig.CameraOptions("look_at"), clipped)
    assert placed.camera.clip_start is None
    with pytest.raises(ValueError, match=r"camera\.clip_start must be at least 0"):
        rig.CameraOptions(clip_start=-1.0)


def test_names_and_times_choose(views):
    camera = rig.CameraOptions(names=("cam_0", "cam_1"), times=(0.5,))
    assert [r.camera_name for r in built(views, camera=camera)] == ["cam_0", "cam_1"]


def test_a_time_that_is_rounded_is_that_of_its_frame(views):
    camera = rig.CameraOptions(names=("cam_0",), times=(0.48, 1.0))
    assert [float(r.camera.time) for r in built(views, camera=camera)] == [0.5, 1.0]


def test_an_unknown_camera_is_refused_with_the_one_most_like_it(views):
    many = [dataclasses.replace(views[0], camera_name=f"r_{k:02d}") for k in range(30)]
    says = r"\(r_00, .*, r_09 and 20 others\), got r_011\. Did you mean r_[01]1\?$"
    with pytest.raises(ValueError, match=says):
        built(many, camera=rig.CameraOptions(names=("r_011",)))
    with pytest.raises(ValueError, match=r"among the capture's \(r_00, r_01\), got left\.$"):
        built(many[:2], camera=rig.CameraOptions(names=("left",)))


def test_a_time_without_a_frame_is_refused_with_the_nearest_ones(views):
    camera = rig.CameraOptions(names=("cam_0",), times=(0.5, 0.4))
    says = (
        r"camera.times must be .* got 0.4; the nearest are 0, 0.5. camera=look_at takes any time.*"
        r"run's cameras.json, and name it: cameras=COPY.json camera.split=all. .* film.size=\[W,H\]"
    )
    with pytest.raises(ValueError, match=says):
        built(views, camera=camera)


def test_a_copy_of_the_cameras_renders_them_at_other_times(views, tmp_path):
    """What the message about a time without a frame advises."""
    file = tmp_path / "cameras.json"
    write_manifest(file, toy.records())
    content = json.loads(file.read_text())
    content["frames"] = [{**content["frames"][0], "time": 0.4}]
    (tmp_path / "copy.json").write_text(json.dumps(content))
    others = load_views(tmp_path, tmp_path / "copy.json")
    (record,) = built(others, camera=rig.CameraOptions(split="all"))
    assert float(record.camera.time) == pytest.approx(0.4)
    poses = [pose_at(x.trajectory, x.time) for x in (record.camera, views[0].camera)]
    np.testing.assert_allclose(poses[0].translation, poses[1].translation, atol=1e-6)


def test_a_capture_without_held_out_cameras_is_rendered_from_all(views):
    trained = [dataclasses.replace(view, split="train") for view in views]
    assert len(built(trained)) == len(views)


def test_both_splits_of_a_capture_can_be_rendered(views):
    mixed = [dataclasses.replace(v, split=("train", "test")[k % 2]) for k, v in enumerate(views)]

    def count(split):
        return len(built(mixed, camera=rig.CameraOptions(split=split)))

    assert min(count("train"), count("test")) > 0
    assert count("train") + count("test") == count("all") == len(views)


def test_every_lens_is_what_it_says(views):
    k = (0.0, -0.0745, -1.5e-4, -2.5e-5, 2e-7)
    flat = built(views, lens=rig.LensOptions("pinhole", 90.0))[0]
    assert isinstance(flat.camera.lens, Pinhole) and flat.effect == "pinhole"
    np.testing.assert_allclose(flat.camera.lens.focal, toy.SIZE / 2, rtol=1e-6)
    fish = built(views, lens=rig.LensOptions("fisheye_polynomial", 166.0, k))[0]
    assert isinstance(fish.camera.lens, FisheyePolynomial) and fish.effect == "fisheye"
    kannala = built(views, lens=rig.LensOptions("kannala_brandt", 150.0, (-0.02, 0.0, 0.0, 0.0)))[0]
    assert isinstance(kannala.camera.lens, KannalaBrandt)
    np.testing.assert_allclose(kannala.camera.lens.max_angle, np.deg2rad(75), rtol=1e-6)


CHOICES = sorted(path.stem for path in (conf_folder() / "lens").glob("*.yaml"))


@pytest.mark.parametrize("choice", [name for name in CHOICES if name not in ("keep", "table")])
def test_every_choice_of_lens_is_one_that_fills_the_picture_and_is_named(views, choice):
    cfg = compose_config("render", ["scene=x", "out=x", f"lens={choice}"])
    record = built(views, lens=build_options(rig.LensOptions, cfg.lens))[0]
    if models_by_name()[cfg.lens.model].perspective:
        expected = "distortion" if cfg.lens.k else "pinhole"
    else:
        expected = choice if choice == "equirectangular" else "fisheye"
    assert record.effect == expected
    column = jnp.arange(toy.SIZE, dtype=jnp.float32) + 0.5
    middle = jnp.stack([column, jnp.full_like(column, toy.SIZE / 2)], -1)
    direction = np.asarray(look(record.camera.lens, middle))
    assert (direction != 0).any(axis=-1).all()
    assert direction[toy.SIZE // 2 - 1 : toy.SIZE // 2 + 1, 2].min() > 0.9
    angle = np.arctan2(direction[:, 0], direction[:, 2])
    spanned = np.rad2deg(np.unwrap(angle))
    # From side to side it spans the field of view, less half a pixel each; at an orthographic rim
    # that is much, and the polynomials suit other pictures.
    if choice not in ("fisheye", "f_theta", "opencv", "orthographic"):
        assert spanned[-1] - spanned[0] == pytest.approx(cfg.lens.fov, rel=0.1)


@pytest.mark.slow
def test_a_table_of_rays_is_mounted_from_its_file(views, tmp_path):
    mounted = built(views, lens=rig.LensOptions("double_sphere", 150.0, (-0.2, 0.6)))[0]
    place = jnp.arange(33) + 0.5
    pixel = jnp.stack(jnp.meshgrid(place, place), -1) * toy.SIZE / 33
    rays = np.asarray(jax.vmap(look, in_axes=(None, 0))(mounted.camera.lens, pixel))
    lit = np.any(rays != 0, axis=-1)
    np.savez(tmp_path / "rays.npz", rays=rays)
    write_image(tmp_path / "rays.exr", rays, depth="half")
    for name, error in (("rays.npz", 1e-4), ("rays.exr", 1e-3)):
        record = built(views, lens=rig.LensOptions("table", file=str(tmp_path / name)))[0]
        assert record.effect == "ray_table"
        again = np.asarray(jax.vmap(look, in_axes=(None, 0))(record.camera.lens, pixel))
        same = np.any(again != 0, axis=-1)
        assert lit.sum() > same.sum() > 0.6 * lit.sum()
        np.testing.assert_allclose(again[same], rays[same], atol=error)


@pytest.mark.parametrize(
    "lens, message",
    [
        (("spherical",), "lens.model must be keep or one of .*pinhole, .*, got 'spherical'"),
        (("pinhole", 180.0), r"lens.fov must be in \(0, 180\) for a pinhole, got 180.0"),
        (("pinhole", 65.0, (0.1,)), "lens.k must hold 0 or 4 or 5 or 8 or 12 or 14 coeff.* got 1"),
        (("orthographic", 190.0), r"lens.fov must be in \(0, 180\] for orthographic, got 190.0"),
        (("equidistant", 400.0), r"lens.fov must be in \(0, 360\] degrees, got 400.0"),
        (("unified_sphere", 200.0, (0.1,)), "lens.k must be monotone"),
        (("double_sphere", 190.0, (0.1,)), "lens.k must hold 2 coefficients for double_sphere"),
        (("f_theta", 90.0, (0.0, 0.1), (1.0, 1.0), 1.0, "x"), "lens.polynomial must be one of"),
        (("equirectangular", 360.0, (), (1.0, 1.0), 200.0), r"lens.fov_y must be in \(0, 180\] d"),
        (("equisolid", 90.0, (0.1,)), "lens.k must hold 0 coefficients for equisolid, got 1"),
        (("table",), "lens.file must name a table of directions"),
    ],
)
def test_impossible_lenses_are_refused_by_key_and_rule(views, lens, message):
    with pytest.raises(ValueError, match=message):
        built(views, lens=rig.LensOptions(*lens))


def test_a_lens_that_sees_behind_focuses_on_a_sphere(views):
    lens = rig.LensOptions("equidistant", 220.0)
    with pytest.raises(ValueError, match="aperture.focus must be sphere .* got plane"):
        built(views, lens=lens, aperture=rig.ApertureOptions(0.1, 2.5))
    sphere = built(views, lens=lens, aperture=rig.ApertureOptions(0.1, 2.5, focus="sphere"))[0]
    assert sphere.effect == "fisheye+depth_of_field"


def test_effects_compose_and_are_named(views):
    shutter = rig.ShutterOptions("rolling", 0.25, 0.1, "left_to_right")
    aperture = rig.ApertureOptions(0.09, 2.0, blades=6)
    record = built(views, shutter=shutter, aperture=aperture,
                   film=rig.FilmOptions("gaussian", 2.0))[0]  # fmt: skip
    assert record.effect == "depth_of_field+rolling_shutter+motion_blur"
    camera = record.camera
    np.testing.assert_allclose(camera.shutter.row_offset, -0.125)
    np.testing.assert_allclose(camera.shutter.row_step * (toy.SIZE - 1), 0.25, rtol=1e-6)
    assert camera.shutter.direction == "left_to_right" and camera.aperture.blades == 6
    assert camera.film.filter == "gaussian" and camera.film.filter_width == 2.0


def test_a_ride_passes_every_camera(views):
    options = rig.CameraOptions(names=("cam_0", "cam_1", "cam_2"))
    records = built(views, camera=options, trajectory=rig.TrajectoryOptions("between", 7))
    assert len(records) == 7 and len({r.file_path for r in records}) == 7
    times = [float(r.camera.time) for r in records]
    np.testing.assert_allclose(times, np.linspace(0, 1, 7), rtol=1e-6)
    assert records[0].camera.trajectory.time.shape == (3,)


def test_a_rim_and_a_focus_pull_are_those_of_the_keys(views):
    pull = {"focus_times": (0.0, 1.0), "focus_distances": (2.0, np.inf), "focus_ease": "smooth"}
    options = rig.ApertureOptions(0.09, rim_radius=0.1, rim_distance=0.3, **pull)
    aperture = built(views, aperture=options)[0].camera.aperture
    np.testing.assert_array_equal(aperture.focus_distance.distance, [2, np.inf])
    assert aperture.focus_distance.ease == "smooth"
    np.testing.assert_allclose([aperture.rim.radius, aperture.rim.distance], [0.1, 0.3])


def test_a_readout_is_a_row_step_and_fields_and_tables_are_row_times(views):
    rows = toy.SIZE
    by_time = built(views, shutter=rig.ShutterOptions("rolling", 0.25))[0].camera.shutter
    step = rig.ShutterOptions("rolling", row_step=0.25 / (rows - 1))
    by_step = built(views, shutter=step)[0].camera.shutter
    for key in ("row_offset", "row_step"):
        np.testing.assert_allclose(getattr(by_step, key), getattr(by_time, key), rtol=1e-6)
    fields = rig.ShutterOptions("interlaced", field_time=0.1, first_field="odd")
    record = built(views, shutter=fields)[0]
    assert record.effect == "interlaced"
    np.testing.assert_allclose(record.camera.shutter.row_times[:3], [0.05, -0.05, 0.05])
    # Fields are rows of the picture: the last row, which is read first, is an odd one.
    upwards = dataclasses.replace(fields, direction="bottom_to_top")
    shutter = built(views, shutter=upwards)[0].camera.shutter
    assert rows % 2 == 0
    np.testing.assert_allclose(shutter.row_times[:2], [-0.05, 0.05])
    times = tuple(float(x) for x in np.linspace(0, 1, rows) ** 2)
    table = built(views, shutter=rig.ShutterOptions("table", row_times=times))[0]
    assert table.effect == "rolling_shutter"
    np.testing.assert_allclose(table.camera.shutter.row_times, times, rtol=1e-6)


def test_every_camera_has_its_trigger(views):
    chosen = rig.CameraOptions(names=("cam_0", "cam_2"))
    shutter = rig.ShutterOptions("rolling", 0.25, trigger=(0.0, 0.02))
    for record in built(views, camera=chosen, shutter=shutter):
        expected = {"cam_0": 0.0, "cam_2": 0.02}[record.camera_name]
        np.testing.assert_allclose(record.camera.shutter.trigger, expected)
    for record in built(views, camera=chosen, shutter=rig.ShutterOptions(trigger=(0.3,))):
        np.testing.assert_allclose(record.camera.shutter.trigger, 0.3)


@pytest.mark.parametrize(
    ("group", "chosen", "message"),
    [
        ("shutter", {"kind": "table", "row_times": (0.0, 1.0)}, "shutter.row_times must be one"),
        ("shutter", {"kind": "global", "row_step": 0.1}, "shutter.row_step needs shutter.kind="),
        ("shutter", {"kind": "rolling", "readout": 1.0, "row_step": 0.1}, "both say how long"),
        ("shutter", {"kind": "rolling", "row_times": (1.0,)}, "shutter.row_times needs"),
        ("shutter", {"trigger": (0.1, 0.2)}, "shutter.trigger must be one delay, or one for each"),
        ("shutter", {"kind": "interlaced", "first_field": "x"}, "shutter.first_field must be"),
        (
            "aperture",
            {"radius": 0.1, "focus_distance": 2.5, "rim_radius": 0.1},
            "aperture.rim_distance must be above 0",
        ),
        ("aperture", {"radius": 0.1}, "aperture.focus_distance = auto must be numbers"),
        ("aperture", {"radius": 0.1, "focus_times": (0.0,)}, "aperture.focus_distances must be"),
        ("trajectory", {"file": "a.txt"}, "trajectory.file needs trajectory.kind=path"),
        ("trajectory", {"kind": "path"}, "trajectory.kind=path needs trajectory.file"),
        ("trajectory", {"interpolation": "x"}, "trajectory.interpolation must be one of"),
        ("trajectory", {"shake_degrees": -1.0}, "trajectory.shake_degrees must be at least 0"),
        (
            "trajectory",
            {"shake_degrees": 1.0, "shake_time": 0.0},
            "trajectory.shake_time must be above 0",
        ),
    ],
)
def test_what_cannot_be_built_is_refused_by_its_key(views, group, chosen, message):
    kinds = {
        "shutter": rig.ShutterOptions,
        "aperture": rig.ApertureOptions,
        "trajectory": rig.TrajectoryOptions,
    }
    with pytest.raises(ValueError, match=message):
        built(views, **{group: kinds[group](**chosen)})


def test_every_camera_is_held_by_a_hand_of_its_own_on_any_path(views):
    options = rig.CameraOptions(names=("cam_0", "cam_1"))
    hand = {"shake_degrees": 0.5, "shake_distance": 0.01, "shake_time": 0.2, "shake_seed": 5}
    for record in built(views, camera=options, trajectory=rig.TrajectoryOptions(**hand)):
        shake = record.camera.trajectory.shake
        assert shake.seed == {"cam_0": 5, "cam_1": 6}[record.camera_name]
        np.testing.assert_allclose(shake.turn, np.deg2rad(0.5), rtol=1e-6)
    ride = rig.TrajectoryOptions("between", 3, interpolation="spline", **hand)
    path = built(views, camera=options, trajectory=ride)[0].camera.trajectory
    assert path.interpolation == "spline" and path.shake.seed == 5


TUM = """# time x y z qx qy qz qw
100.0 0 0 -3 0 0 0 1
100.5 1 0 -3 0 0 0 1
102.0 2 0 -3 0 0.6 0 0.8
"""


@pytest.mark.parametrize("clock", ["span", "file"])
def test_a_path_comes_from_a_file(views, tmp_path, clock):
    (tmp_path / "path.txt").write_text(TUM)
    options = rig.TrajectoryOptions("path", 5, file=str(tmp_path / "path.txt"), clock=clock)
    records = built(views, trajectory=options)
    first, last = (0, 1) if clock == "span" else (100, 102)
    times = [float(r.camera.time) for r in records]
    np.testing.assert_allclose(times, np.linspace(first, last, 5), rtol=1e-6)
    path = records[0].camera.trajectory
    np.testing.assert_allclose(path.time, first + (last - first) * np.array([0, 0.25, 1]))
    np.testing.assert_allclose(path.quat[2], [0.8, 0, 0.6, 0], rtol=1e-6)
    np.testing.assert_array_equal(path.translation[1], [1, 0, -3])


def test_pictures_are_png_or_exr(views):
    records = rig.frame_records(views, options=rig.RigOptions(), samples=1, format="exr")
    assert all(record.file_path.endswith(".exr") for record in records)
    with pytest.raises(ValueError, match="format must be png .* or exr .*, got 'jpg'"):
        rig.frame_records(views, options=rig.RigOptions(), samples=1, format="jpg")


def test_a_picture_of_another_size_shows_the_same_view(views):
    """A point's pixel moves with the size: the field of view across stays, or is cut, or widens."""
    camera = views[-1].camera
    point = jnp.asarray([0.3, -0.2, 3.0], jnp.float32)
    at = camera.lens.project(point) - toy.SIZE / 2
    scales = {"width": 48 / toy.SIZE, "crop": 48 / toy.SIZE, "letterbox": 24 / toy.SIZE}
    for fit, scale in scales.items():
        film = rig.FilmOptions(size=(48, 24), fit=fit)
        made = built(views, film=film)[-1].camera
        assert (made.film.width, made.film.height) == (48, 24)
        seen = made.lens.project(point) - np.array([24.0, 12.0])
        np.testing.assert_allclose(seen, scale * at, rtol=1e-4)
    tall = built(views, film=rig.FilmOptions(size=(16, 32), fit="crop"))[-1].camera
    np.testing.assert_allclose(tall.lens.focal, 2 * np.asarray(camera.lens.focal), rtol=1e-6)


def test_the_readout_of_a_resized_picture_lasts_as_long():
    camera = toy.rolling(toy.camera())
    made = apply_film(camera, rig.FilmOptions(size=(32, 32)))
    times = [np.asarray(row_moments(c.shutter, (n, n))) for c, n in ((camera, 16), (made, 32))]
    # Row 2 i + 1/2 of the new picture is row i of the old one.
    np.testing.assert_allclose((times[1][::2] + times[1][1::2]) / 2, times[0], atol=1e-6)


def test_the_filter_keeps_its_kind_where_its_width_alone_is_given(views):
    kept = built(views, film=rig.FilmOptions(filter_width=2.0))[-1].camera.film
    assert (kept.filter, kept.filter_width) == (toy.camera().film.filter, 2.0)


@pytest.mark.parametrize("name", ["fisheye", "equisolid", "kannala_brandt", "double_sphere"])
def test_a_fisheye_is_a_circle_and_its_field_of_view_spans_the_smaller_side(views, name):
    wide = rig.FilmOptions(size=(48, 24))
    chosen = ["scene=x", "out=x", f"lens={name}", "lens.fov=150"]
    options = build_options(rig.LensOptions, compose_config("render", chosen).lens)
    lens = built(views, film=wide, lens=options)[-1].camera.lens
    middle, half = np.array([24.0, 12.0]), np.deg2rad(75)
    directions = [[np.sin(half), 0, np.cos(half)], [0, np.sin(half), np.cos(half)]]
    away = [lens.project(jnp.asarray(d, jnp.float32) * 0.9999) - middle for d in directions]
    np.testing.assert_allclose(np.linalg.norm(away, axis=-1), 12, rtol=2e-3)
    cut = dataclasses.replace(options, crop=100.0)
    cropped = built(views, film=wide, lens=cut)[-1].camera.lens
    inside, outside = (jnp.asarray([24 + 12 * r, 12.0], jnp.float32) for r in (0.5, 0.8))
    np.testing.assert_allclose(cropped.direction(inside), lens.direction(inside), atol=1e-5)
    assert not np.any(cropped.direction(outside)) and np.any(lens.direction(outside))


def test_a_camera_is_placed_without_a_capture():
    scene = toy.scene()
    (view,) = placed_views(
        scene, rig.CameraOptions("look_at", eye=(0.0, -4.0, 0.0), target=(0.0, 0.0, 0.0))
    )
    np.testing.assert_allclose(view.camera.lens.project(jnp.array([0.0, 0, 4])), [480, 320])
    np.testing.assert_allclose(view.camera.trajectory.translation[0], [0, -4, 0])
    circle = placed_views(scene, rig.CameraOptions("orbit", frames=4, eye=(0.0, -4.0, 1.0)))
    assert [view.time for view in circle] == pytest.approx([0, 1 / 3, 2 / 3, 1])
    places = [pose_at(v.camera.trajectory, v.camera.time).translation[:2] for v in circle]
    middle = np.mean(places, axis=0)
    angles = np.unwrap([np.arctan2(*(p - middle)[::-1]) for p in places])
    np.testing.assert_allclose(np.diff(angles), np.pi / 2, atol=1e-3)


def test_a_placed_camera_sees_the_scene_where_nothing_is_said():
    scene = toy.scene(speed=0)
    up = rig.CameraOptions("look_at", up=(0.0, -1.0, 0.0))
    (view,) = placed_views(scene, up)
    local = pose_at(view.camera.trajectory, view.camera.time)
    seen = jax.vmap(lambda p: view.camera.lens.project(local.inverse_apply(p)))(scene.static.mean)
    inside = np.all((np.asarray(seen) > 0) & (np.asarray(seen) < [960, 640]), axis=-1)
    assert np.mean(inside) > 0.8


def test_an_orbit_without_an_eye_starts_at_one_of_the_captures_cameras_and_is_level():
    scene, up = toy.scene(speed=0), np.array([0.0, -0.6, 0.8])
    places = [np.array(p, float) for p in ((4, 0, 1), (0, 3, 1), (-2, 0, 1), (0, -5, 1))]
    turned = np.array([[1, 0, 0], [0, 0.8, -0.6], [0, 0.6, 0.8]])  # takes +z to `up`
    np.testing.assert_allclose(turned @ [0, 0, 1], up, atol=1e-12)
    eyes = [turned @ p for p in places]
    views = []
    for eye in eyes:
        eye = tuple(eye.tolist())
        options = rig.CameraOptions("look_at", eye=eye, target=(0.0, 0.0, 0.0), up=(0.0, -0.6, 0.8))
        views += placed_views(scene, options)
    options = rig.CameraOptions("orbit", target=(0.0, 0.0, 0.0), frames=4)
    circle = placed_views(scene, options, views)
    poses = [pose_at(v.camera.trajectory, v.camera.time) for v in circle]
    np.testing.assert_allclose(poses[0].translation, eyes[1], atol=1e-4)  # a quarter are nearer
    for pose in poses:
        np.testing.assert_allclose(pose.translation @ up, eyes[1] @ up, atol=0.03)
        right = np.asarray(rotation_matrix(pose.quat))[:, 0]
        np.testing.assert_allclose(right @ up, 0, atol=5e-3)  # 0.3 degrees


def test_an_orbit_turns_around_a_scene_of_one_time():
    scene = toy.scene(speed=0)
    still = dataclasses.replace(scene, time_range=jnp.asarray([0.5, 0.5]))
    options = rig.CameraOptions("orbit", eye=(0.0, -4.0, 1.0), target=(0.0, 0.0, 0.0), frames=4)
    poses = [pose_at(v.camera.trajectory, v.camera.time) for v in placed_views(still, options)]
    angles = np.unwrap([np.arctan2(*pose.translation[:2][::-1]) for pose in poses])
    np.testing.assert_allclose(np.diff(angles), np.pi / 2, atol=1e-3)


def test_cameras_side_by_side_have_the_mean_of_their_upward_axes():
    scene = toy.scene(speed=0)
    views = []
    for x in (-0.5, 0.0, 0.5):
        options = rig.CameraOptions("look_at", eye=(x, -4.0, 0.0), target=(x, 0.0, 0.0))
        views += placed_views(scene, options)
    (view,) = placed_views(scene, rig.CameraOptions("look_at", target=(0.0, 0.0, 0.0)), views)
    pose = pose_at(view.camera.trajectory, view.camera.time)
    np.testing.assert_allclose(rotation_matrix(pose.quat)[:, 1], [0, 0, -1], atol=1e-4)


@pytest.mark.parametrize(
    ("groups", "message"),
    [
        ({"lens": rig.LensOptions(fov=120.0)}, "lens.fov has no effect with lens=keep. Choose a l"),
        (
            {"lens": rig.LensOptions("pinhole", 60.0, fov_y=90.0)},
            "lens.fov_y has no effect with le",
        ),
        (
            {"aperture": rig.ApertureOptions(focus_distance=3.0)},
            "aperture.focus_distance has no ef",
        ),
        (
            {"shutter": rig.ShutterOptions(direction="bottom_to_top")},
            "shutter.direction has no eff",
        ),
        (
            {"trajectory": rig.TrajectoryOptions(shake_time=3.0)},
            "trajectory.shake_time has no effect",
        ),
        (
            {"camera": rig.CameraOptions(eye=(0.0, 0.0, 1.0))},
            "camera.eye has no effect with camera=default. Choose camera=look_at or orbit.$",
        ),
        (
            {"camera": rig.CameraOptions(frames=3)},
            "camera.frames has no effect with camera=default. .* by their times: camera.times=",
        ),
        (
            {"camera": rig.CameraOptions("orbit", names=("a",))},
            "camera.names has no effect with camera=orbit. Choose camera=default.$",
        ),
        (
            {"shutter": rig.ShutterOptions("table", row_times=(0.0, 1.0), first_field="odd")},
            "shutter.first_field has no effect with shutter.kind=table. Choose shutter=interlaced",
        ),
    ],
)
def test_a_key_that_its_choice_ignores_is_refused(groups, message):
    with pytest.raises(ValueError, match=message):
        check_used_keys(rig.RigOptions(**groups))


@pytest.mark.parametrize("kind", CAMERA_KINDS)
def test_every_camera_may_leave_out_what_is_near(kind):
    check_used_keys(rig.RigOptions(camera=rig.CameraOptions(kind, clip_start=0.1)))


def test_a_table_of_row_times_chooses_a_kind_that_can_be_set():
    options, notes = apply_implied_choices(
        rig.RigOptions(shutter=rig.ShutterOptions(row_times=(0.0, 1.0)))
    )
    assert options.shutter.kind == "table" and notes[0].endswith(" chooses shutter.kind=table.")


@pytest.mark.parametrize(
    ("key", "kind"), [("readout", "rolling"), ("field_time", "interlaced"), ("exposure", "global")]
)
def test_a_key_of_a_shutter_switches_it_on(key, kind):
    options, notes = apply_implied_choices(rig.RigOptions(shutter=rig.ShutterOptions(**{key: 0.2})))
    assert options.shutter.kind == kind
    assert notes == [f"shutter.{key}=0.2 chooses shutter={kind}."]
    check_used_keys(options)


def test_every_choice_of_a_file_uses_its_own_keys():
    for group in ("lens", "aperture", "shutter", "trajectory", "film", "camera"):
        for path in (conf_folder() / group).glob("*.yaml"):
            cfg = compose_config("render", ["scene=x", "out=x", f"{group}={path.stem}"])
            check_used_keys(rig_options(cfg))
