"""Instants, parts, sizes and held-out cameras: the scene stays where it is in the picture."""

import dataclasses
import json

import films
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gaussray.camera.film import pixel_grid
from gaussray.camera.shutter import DIRECTIONS, sample_time
from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.paired import read_capture
from gaussray.capture.frames import read_encoded, read_mask
from gaussray.capture.open import open_capture
from gaussray.capture.selection import Selection, selected
from gaussray.capture.view_file import check_images
from gaussray.color import srgb_decode, srgb_encode
from gaussray.dataset.images import write_image
from gaussray.reconstruct.data.pictures import footage


# A code is rounded to the nearest.
CODE = 0.5
# Double precision through lens and pose, in pixels.
PIXELS = 1e-9
W, H = 24, 16
POSE = [[1, 0, 0, 0.1], [0, 1, 0, -0.2], [0, 0, 1, 3.0], [0, 0, 0, 1]]
INTRINSICS = {"w": W, "h": H, "fl_x": 20, "fl_y": 21, "cx": 11, "cy": 8.5}
LENSES = {
    "pinhole": {},
    "distorted": {"camera_model": "OPENCV", "k1": 0.05, "k2": -0.01, "p1": 0.002, "p2": 0.001},
    "kannala_brandt": {"camera_model": "OPENCV_FISHEYE", "k1": 0.01, "k2": -0.002},
    "thin_prism": {"camera_model": "OPENCV", "k1": 0.05, "s1": 0.01, "s4": -0.02, "tau_x": 0.03},
    "sphere": {"camera_model": "EQUIRECTANGULAR", "fl_x": 12, "fl_y": 16, "cx": 12, "cy": 8},
    "double_sphere": {"lens": {"model": "double_sphere", "k": [-0.2, 0.6], "fov": 3.6}},
    "f_theta": {
        "fl_x": 1,
        "fl_y": 1,
        "lens": {"model": "f_theta", "polynomial": "angle_of_radius", "k": [0, 0.06], "fov": 3},
    },
    "polynomial": {
        "lens": {
            "model": "blender_fisheye_polynomial",
            "k": [0.0, -0.06, 0.0, 0.0, 0.0],
            "sensor_width_mm": 36.0,
            "sensor_height_mm": 24.0,
            "fov": 4.0,
            "shift": [0.05, -0.1],
        }
    },
}
# Points in front of the camera.
POINTS = jnp.array([[0.1, -0.2, 3.0], [0.4, -0.5, 3.3], [-0.7, 0.3, 2.1], [0.1, -0.2, 2.0]])
projected = jax.jit(jax.vmap(lambda lens, point: lens.project(point), in_axes=(None, 0)))
directions = jax.jit(jax.vmap(lambda lens, pixel: lens.direction(pixel), in_axes=(None, 0)))


def frame(camera, i, **more):
    name = f"{camera}/{i:04d}.png"
    return {"file_path": name, "transform_matrix": POSE, "time": i / 4, "camera": camera, **more}


def lay(folder, keys=None, cameras=("a", "b", "c"), count=4, split="train"):
    """A paired capture of noise."""
    dice = np.random.default_rng(0)
    frames = [frame(camera, i) for camera in cameras for i in range(count)]
    for one in frames:
        write_image(folder / one["file_path"], dice.integers(0, 256, (H, W, 3), np.uint8))
    document = {**INTRINSICS, **(keys or {}), "split": split, "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(document))
    return folder


@pytest.fixture
def capture(tmp_path):
    return read_capture(lay(tmp_path), jnp.float64)


def of(capture, **options):
    return selected(capture, Selection(**options))


def test_the_defaults_are_the_whole_capture(capture):
    same = of(capture)
    assert all(a is b for a, b in zip(same.views, capture.views, strict=True))
    assert same.time_range == (0.0, 0.75)


@pytest.mark.parametrize(
    ("frames", "times"),
    [
        ((0, -1, 1), [0, 0.25, 0.5, 0.75]),
        ((1, 3, 2), [0.25, 0.75]),
        ((0, 2, 1), [0, 0.25, 0.5]),
        ((-2, -1, 1), [0.5, 0.75]),
        ((2, 2, 5), [0.5]),
    ],
)
def test_instants_are_chosen_by_first_last_and_step(capture, frames, times):
    part = of(capture, frames=frames)
    assert [view.time for view in part.views] == times * 3
    assert part.time_range == (times[0], times[-1])


def test_effects_are_kept_at_the_instants_that_are(tmp_path):
    lay(tmp_path)
    for name, time in (("blur", 0.25), ("rolling", 0.5)):
        effect = {**INTRINSICS, "split": "test", "frames": [{**frame("a", 0), "time": time}]}
        (tmp_path / f"{name}.json").write_text(json.dumps(effect))
    part = of(read_capture(tmp_path), frames=(0, 1, 1), scale=0.5)
    assert {name: len(views) for name, views in part.effects.items()} == {"blur": 1}
    assert part.effects["blur"][0].width == W // 2
    (tmp_path / "transforms.json").unlink()
    alone = of(read_capture(tmp_path), frames=(1, 1, 1))
    assert list(alone.effects) == ["rolling"] and alone.time_range == (0.5, 0.5)


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("crop", [(), (3, 2, 16, 12), (0, 0, 5, 16)])
@pytest.mark.parametrize("scale", [1.0, 0.5, 0.37])
def test_points_and_rays_stay_where_they_are_in_the_picture(tmp_path, lens, crop, scale):
    whole = read_capture(lay(tmp_path, LENSES[lens], "a", 1), jnp.float64).views[0].camera
    part = of(read_capture(tmp_path, jnp.float64), crop=crop, scale=scale).views[0].camera
    left, top, width, height = crop or (0, 0, W, H)
    size = np.array([part.film.width, part.film.height])
    assert (size == [max(round(scale * side), 1) for side in (width, height)]).all()
    share = size / (width, height)
    expected = (np.asarray(projected(whole.lens, POINTS)) - (left, top)) * share
    assert np.isfinite(expected).all()
    np.testing.assert_allclose(projected(part.lens, POINTS), expected, atol=PIXELS)
    center = np.array([[0, 0], [size[0] - 1, size[1] - 1], [size[0] // 2, 1]]) + 0.5
    found = directions(part.lens, jnp.asarray(center))
    same = directions(whole.lens, jnp.asarray(center / share + (left, top)))
    np.testing.assert_allclose(found, same, atol=1e-9)
    assert np.linalg.norm(found, axis=1) == pytest.approx(1)


@pytest.mark.parametrize("direction", DIRECTIONS)
@pytest.mark.parametrize("scale", [1.0, 0.5, 0.25])
def test_every_row_has_the_mean_time_of_the_rows_it_is_made_of(tmp_path, direction, scale):
    shutter = {"row_offset": -0.1, "row_step": 0.02, "exposure": 0.0, "direction": direction}
    whole = read_capture(lay(tmp_path, {"shutter": shutter}, "a", 1), jnp.float64).views[0].camera
    crop = (4, 4, 16, 8)
    part = of(read_capture(tmp_path, jnp.float64), crop=crop, scale=scale).views[0].camera

    def times(camera):
        film, half = camera.film, jnp.array(0.5)

        def of_pixel(pixel):
            size = (film.width, film.height)
            return sample_time(camera.shutter, pixel, size, camera.time, half)

        return np.asarray(jax.vmap(jax.vmap(of_pixel))(pixel_grid(film)))

    side = round(1 / scale)
    rows = times(whole)[4:12, 4:20].reshape(8 // side, side, 16 // side, side)
    np.testing.assert_allclose(times(part), rows.mean(axis=(1, 3)), atol=1e-12)


@pytest.mark.parametrize("scale", [1.0, 0.5, 0.25])
def test_a_table_of_row_times_is_cut_and_averaged_with_its_rows(tmp_path, scale):
    times = np.random.default_rng(5).normal(size=16).round(3)
    shutter = {"row_times": times.tolist(), "trigger": 0.5}
    lay(tmp_path, {"shutter": shutter}, "a", 1)
    whole = read_capture(tmp_path, jnp.float64).views[0].camera.shutter
    part = of(read_capture(tmp_path, jnp.float64), crop=(4, 4, 16, 8), scale=scale).views[0].camera
    expected = np.asarray(whole.row_times)[4:12].reshape(-1, round(1 / scale)).mean(axis=1)
    np.testing.assert_allclose(part.shutter.row_times, expected, atol=1e-12)
    assert part.shutter.trigger == 0.5


def test_pictures_are_cut_and_averaged_in_linear_light(tmp_path):
    capture = of(read_capture(lay(tmp_path)), crop=(2, 4, 20, 12), scale=0.5)
    pictures = films.load(capture.views)
    assert pictures.dtype == np.uint8 and pictures.shape == (12, 6, 10, 3)
    full = films.load(read_capture(tmp_path).views)[:, 4:16, 2:22] / 255
    light = srgb_decode(full).reshape(12, 6, 2, 10, 2, 3).mean(axis=(2, 4))
    expected = 255 * srgb_encode(light)
    np.testing.assert_allclose(pictures, expected, atol=CODE + 1e-3)
    # The mean of the codes themselves is another picture.
    assert np.abs(255 * full.reshape(12, 6, 2, 10, 2, 3).mean(axis=(2, 4)) - expected).max() > 10
    for view, picture in zip(capture.views, pictures, strict=True):
        np.testing.assert_array_equal(read_encoded(view), picture)


def test_a_part_of_a_part_is_that_of_the_file(tmp_path):
    shutter = {"row_offset": -0.1, "row_step": 0.02, "exposure": 0.0}
    lay(tmp_path, {"shutter": shutter | {"direction": "top_to_bottom"}})
    whole = read_capture(tmp_path, jnp.float64)
    once = of(whole, crop=(4, 0, 16, 16), scale=0.25).views[0]
    for parts in (
        [{"crop": (4, 0, 16, 16), "scale": 0.5}, {"scale": 0.5}],
        [{"crop": (4, 0, 20, 16)}, {"crop": (0, 0, 16, 16), "scale": 0.25}],
        [{"scale": 0.5}, {"crop": (2, 0, 8, 8), "scale": 0.5}],
    ):
        twice = whole
        for part in parts:
            twice = of(twice, **part)
        view = twice.views[0]
        np.testing.assert_array_equal(read_encoded(view), read_encoded(once))
        for one, other in zip(
            jax.tree.leaves(view.camera), jax.tree.leaves(once.camera), strict=True
        ):
            np.testing.assert_allclose(one, other, atol=1e-12)


def test_a_cut_alone_leaves_the_codes(tmp_path):
    capture = of(read_capture(lay(tmp_path)), crop=(2, 4, 20, 12))
    full = films.load(read_capture(tmp_path).views)
    np.testing.assert_array_equal(films.load(capture.views), full[:, 4:16, 2:22])


def test_float_pictures_and_masks_are_cut_and_averaged_too(tmp_path):
    light = np.random.default_rng(0).random((H, W, 3)).astype(np.float32)
    write_image(tmp_path / "0.exr", light, depth="float")
    mask = np.zeros((H, W), bool)
    mask[:, :11] = True
    films.write_mask(tmp_path / "m.png", mask)
    one = {**frame("a", 0), "file_path": "0.exr", "mask_path": "m.png"}
    (tmp_path / "transforms.json").write_text(
        json.dumps({**INTRINSICS, "split": "train", "frames": [one]})
    )
    (view,) = of(read_capture(tmp_path), scale=0.5).views
    expected = srgb_encode(light.reshape(8, 2, 12, 2, 3).mean(axis=(1, 3)))
    np.testing.assert_allclose(read_encoded(view), expected, atol=1e-6)
    # Column 5 is half white: it counts.
    seen = read_mask(view.mask, view.width, view.height, view.window)
    assert seen.shape == (8, 12) and seen[:, :6].all() and not seen[:, 6:].any()


def test_frames_of_videos_are_loaded_in_any_order_and_at_any_size(tmp_path):
    for camera in "ab":
        films.film(tmp_path / f"{camera}.mp4", films.shades(6, W, H))
    frames = [
        {**frame(camera, i), "file_path": f"{camera}.mp4/{i:04d}"}
        for i in (4, 0, 2)
        for camera in "ba"
    ]
    (tmp_path / "transforms.json").write_text(
        json.dumps({**INTRINSICS, "split": "train", "frames": frames})
    )
    capture = of(read_capture(tmp_path), scale=0.5)
    check_images(capture.views)
    assert [view.window.size for view in capture.views] == [(W, H)] * 6
    pictures = films.load(capture.views)
    assert pictures.shape == (6, H // 2, W // 2, 3)
    assert [films.index_of(p) for p in pictures] == [4, 4, 0, 0, 2, 2]
    for view, picture in zip(capture.views, pictures, strict=True):
        np.testing.assert_array_equal(read_encoded(view), picture)
    shown = footage(capture.views, side=8)
    np.testing.assert_array_equal(shown.pictures(np.arange(6)), pictures)


def test_wrong_frames_of_videos_are_named_before_and_while_they_are_read(tmp_path):
    films.film(tmp_path / "a.mp4", films.shades(3, W, H + 2))
    films.film(tmp_path / "b.mp4", films.shades(3, W, H))
    frames = [{**frame("a", 0), "file_path": f"{name}.mp4/{i}"} for name, i in (("a", 0), ("b", 3))]
    document = {**INTRINSICS, "split": "train", "frames": frames}
    (tmp_path / "transforms.json").write_text(json.dumps(document))
    views = read_capture(tmp_path).views
    with pytest.raises(CaptureError, match="(?s)2 of 2.*a.mp4/0: .*got 24 x 18.*got 3 frames"):
        check_images(views)
    for read in (lambda view: films.load([view]), read_encoded):
        with pytest.raises(CaptureError, match="a.mp4/0: the picture must be w x h = 24 x 16"):
            read(views[0])
        with pytest.raises(CaptureError, match="b.mp4: the index of a frame must be in 0 ... 2"):
            read(views[1])


def test_cameras_are_held_out_by_name_or_pattern(tmp_path):
    capture = read_capture(lay(tmp_path, cameras=("cam00", "cam01", "cam10"), count=1))
    for test, held in (
        (("cam01",), {"cam01"}),
        (("cam0*",), {"cam00", "cam01"}),
        (("cam1?", "cam00"), {"cam00", "cam10"}),
        ((), set()),
    ):
        part = of(capture, test=test)
        assert {view.camera_name for view in part.views if view.split == "test"} == held
    held = read_capture(lay(tmp_path, count=1, split="test"))
    assert {view.split for view in of(held).views} == {"test"}
    assert {view.split for view in of(held, test=()).views} == {"train"}


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"frames": (0, 3)}, r"capture.frames \(truth_frames\) must be \[\] .* got \[0, 3\]"),
        ({"frames": (0, 3, 0)}, "frames .* step"),
        ({"frames": (0, 1.5, 1)}, "three whole numbers"),
        ({"frames": (0, 4, 1)}, r"4 instants \(0 ... 3\).*got \[0, 4, 1\]"),
        ({"frames": (3, 1, 1)}, "first not after last"),
        ({"frames": (-5, 1, 1)}, "4 instants"),
        ({"crop": (0, 0, 8)}, r"capture.crop \(truth_crop\) must be"),
        ({"crop": (-1, 0, 8, 8)}, r"got \[-1, 0, 8, 8\]"),
        ({"crop": (0, 0, 0, 8)}, "at least 1"),
        ({"crop": (20, 0, 8, 8)}, "within the picture of 24 x 16 at .*a/0000.png"),
        ({"scale": 0.0}, r"capture.scale \(truth_scale\) must be in \(0, 1\], got 0.0"),
        ({"scale": 1.5}, "got 1.5"),
        ({"scale": float("nan")}, "got nan"),
        ({"test": ("d",)}, r"the capture's cameras \(a, b, c\), got \['d'\]"),
        ({"test": ("",)}, "a list of cameras' names"),
    ],
)
def test_a_selection_that_cannot_be_is_named_with_its_key(capture, options, says):
    with pytest.raises(CaptureError, match=says):
        of(capture, **options)


def test_a_pattern_of_whole_names_is_advised_for_a_name_alone(capture):
    with pytest.raises(CaptureError, match=r"such as '\*cam\*'"):
        of(capture, test=("cam",))
    with pytest.raises(CaptureError) as caught:
        of(capture, test=("*d*",))
    assert "must match the whole name" not in str(caught.value)


def test_a_selection_is_handed_on_by_the_door_and_has_no_leaves(tmp_path):
    chosen = Selection(scale=0.5, test=("a",))
    assert not jax.tree.leaves(chosen) and hash(chosen) == hash(dataclasses.replace(chosen))
    views = open_capture(lay(tmp_path, count=1), selection=chosen, background="black").views
    assert [view.split for view in views] == ["test", "train", "train"]
    assert {view.background for view in views} == {"black"} and views[0].width == W // 2
