"""What the manifest writes, the capture reads: the same cameras, for every lens and effect."""

import dataclasses
import json
import warnings

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from lenses import zoo

from gaussray.camera.aperture import Aperture, Rim, no_aperture
from gaussray.camera.camera import Camera, camera_rays
from gaussray.camera.film import Film
from gaussray.camera.focus_pull import FocusPull
from gaussray.camera.lens import FisheyePolynomial, KannalaBrandt, pinhole
from gaussray.camera.shake import Shake
from gaussray.camera.shutter import Shutter, global_shutter
from gaussray.camera.trajectory import Trajectory
from gaussray.capture.formats.paired import read_capture, read_views
from gaussray.dataset.manifest import FrameRecord, write_manifest


# Poses pass through a matrix: a few units in the last place of a quaternion.
POSE_TOLERANCE = {jnp.float32: 1e-6, jnp.float64: 1e-14}

LENSES = {
    "pinhole": lambda: pinhole(jnp.array([50.1, 55.2]), jnp.array([32.3, 23.7])),
    "opencv": lambda: pinhole(
        jnp.array([50.1, 55.2]),
        jnp.array([32.3, 23.7]),
        jnp.array([0.1, -0.02, 1e-3, -2e-3, 5e-3, 0.01, 0.002, 0.0003]),
    ),
    "kannala_brandt": lambda: KannalaBrandt(
        jnp.array([20.1, 20.2]),
        jnp.array([32.3, 23.7]),
        jnp.array([0.01, -0.002, 3e-4, -1e-5]),
        jnp.array(1.7),
    ),
    "fisheye": lambda: FisheyePolynomial(
        jnp.array([0.0, -0.0745, -1.5e-4, -2.5e-5, 2.0e-7]),
        jnp.array([36.0, 27.0]),
        jnp.array([64.0, 48.0]),
        jnp.array([0.01, -0.02]),
        jnp.array(2.9),
    ),
    **{name: lambda lens=lens: lens for name, lens in zoo(64, 48).items()},
}
APERTURE = Aperture(
    jnp.array(0.09), jnp.array(2.3), jnp.array(0.3), jnp.array(1.5), blades=5, focus="sphere"
)
SHUTTER = Shutter(jnp.array(-0.1), jnp.array(1 / 3), jnp.array(0.01), direction="left_to_right")


PULL = FocusPull(jnp.array([0.1, 0.5, 0.9]), jnp.array([2.0, 3.3, jnp.inf]), "smooth")
CAT_EYE = dataclasses.replace(
    APERTURE, focus_distance=PULL, rim=Rim(jnp.array(0.11), jnp.array(0.3))
)
TABLE = dataclasses.replace(SHUTTER, row_times=jnp.arange(64) / 7, trigger=jnp.array(0.03))
SHAKE = Shake(*(jnp.array(x) for x in (0.01, 0.02, 0.3, 12345.0)))


def path_of(poses, seed=0, **more):
    rng = np.random.default_rng(seed)
    return Trajectory(
        jnp.linspace(-0.3, 1.4, poses) if poses > 1 else jnp.zeros(1),
        jnp.asarray(rng.normal(size=(poses, 4))),
        jnp.asarray(rng.normal(size=(poses, 3))),
        **more,
    )


def camera(
    lens="pinhole",
    aperture=None,
    shutter=None,
    poses=1,
    film=None,
    clip_start=None,
    kind=jnp.float64,
    **path,
):
    made = Camera(
        film or Film(64, 48),
        LENSES[lens](),
        aperture or no_aperture(),
        shutter or global_shutter(),
        path_of(poses, **path),
        jnp.array(0.24),
        clip_start=clip_start,
    )
    return jax.tree.map(lambda leaf: leaf.astype(kind), made)


CAMERAS = {
    **{name: {"lens": name} for name in LENSES},
    "depth_of_field": {"aperture": APERTURE},
    "infinity": {"aperture": eqx.tree_at(lambda a: a.focus_distance, APERTURE, jnp.array(jnp.inf))},
    "rolling_shutter": {"shutter": SHUTTER},
    "trajectory": {"poses": 4},
    "cat_eye": {"aperture": CAT_EYE},
    "row_times": {"shutter": TABLE},
    "triggered": {"shutter": dataclasses.replace(global_shutter(), trigger=jnp.array(0.0))},
    "spline": {"poses": 4, "interpolation": "spline"},
    "shaken": {"shake": SHAKE},
    "all": {"aperture": CAT_EYE, "shutter": TABLE, "poses": 3, "shake": SHAKE},
    "box": {"film": Film(64, 48, "box", 1.0)},
    "clipped": {"clip_start": jnp.array(0.3)},
    "everything": {"lens": "fisheye", "aperture": APERTURE, "shutter": SHUTTER, "poses": 3},
}


def record(made, name="cam00", **more):
    return FrameRecord(f"images/{name}.png", made, name, "test", **more)


# Of single precision too, but for some the slow run.
SINGLE = ("pinhole", "fisheye", "table", "infinity", "trajectory", "everything")
KINDS = [
    pytest.param(
        name, kind, marks=() if kind == jnp.float64 or name in SINGLE else pytest.mark.slow
    )
    for name in CAMERAS
    for kind in (jnp.float32, jnp.float64)
]


@pytest.mark.parametrize(("name", "kind"), KINDS)
def test_every_camera_reads_back_as_it_was(tmp_path, name, kind):
    made = camera(**CAMERAS[name], kind=kind)
    write_manifest(tmp_path / "out.json", [record(made, effect=name, samples=16)])
    (view,) = read_views(tmp_path / "out.json", kind)
    assert (view.effect, view.samples, view.camera_name, view.split) == (name, 16, "cam00", "test")
    read, path = view.camera, made.trajectory
    assert read.trajectory.interpolation == path.interpolation
    assert eqx.tree_equal(read.trajectory.shake, path.shake)
    np.testing.assert_array_equal(read.trajectory.time, path.time)
    assert eqx.tree_equal(read, eqx.tree_at(lambda c: c.trajectory, made, read.trajectory))
    tolerance = POSE_TOLERANCE[kind]
    unit = made.trajectory.quat / jnp.linalg.norm(made.trajectory.quat, axis=-1, keepdims=True)
    alike = jnp.abs(jnp.sum(unit * read.trajectory.quat, axis=-1))
    np.testing.assert_allclose(alike, 1, atol=tolerance)
    np.testing.assert_array_equal(read.trajectory.translation, made.trajectory.translation)


@eqx.filter_jit
def rays_of(made):
    rng = np.random.default_rng(1)
    pixel = jnp.asarray(rng.integers(0, 48, (50, 2)).astype(float))
    return camera_rays(made, pixel, jnp.asarray(rng.random((50, 5))))


def test_a_camera_with_everything_sends_the_same_rays(tmp_path):
    made = camera(**CAMERAS["everything"])
    write_manifest(tmp_path / "out.json", [record(made)])
    (view,) = read_views(tmp_path / "out.json", jnp.float64)
    ours, theirs = rays_of(view.camera), rays_of(made)
    assert jnp.any(theirs.direction != 0)
    for a, b in zip(jax.tree.leaves(ours), jax.tree.leaves(theirs), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-12)


def test_a_plain_pinhole_holds_only_what_nerfstudio_knows(tmp_path):
    write_manifest(tmp_path / "transforms.json", [record(camera())])
    content = json.loads((tmp_path / "transforms.json").read_text())
    known = {"w", "h", "fl_x", "fl_y", "cx", "cy", "camera_model", "frames"}
    assert set(content) == known and content["camera_model"] == "PINHOLE"
    frame = {"file_path", "camera", "split", "time", "transform_matrix"}
    assert set(content["frames"][0]) == frame


def test_blenders_axes_are_written(tmp_path):
    made = camera()
    identity = Trajectory(jnp.zeros(1), jnp.array([[1.0, 0, 0, 0]]), jnp.array([[1.0, 2, 3]]))
    made = eqx.tree_at(lambda c: c.trajectory, made, identity)
    write_manifest(tmp_path / "out.json", [record(made)])
    (frame,) = json.loads((tmp_path / "out.json").read_text())["frames"]
    assert frame["transform_matrix"] == [[1, 0, 0, 1], [0, -1, 0, 2], [0, 0, -1, 3], [0, 0, 0, 1]]


def test_what_all_frames_share_stands_once_and_a_frame_is_a_line(tmp_path):
    views = [
        record(camera(shutter=SHUTTER), "a"),
        record(camera(shutter=SHUTTER, aperture=APERTURE), "b", mask_path="masks/b.png"),
    ]
    write_manifest(tmp_path / "out.json", views, extra={"time_unit": "s", "info": {"made": "here"}})
    text = (tmp_path / "out.json").read_text()
    content = json.loads(text)
    assert "shutter" in content and "aperture" not in content and content["time_unit"] == "s"
    assert ["aperture" in frame for frame in content["frames"]] == [False, True]
    assert sum(line.startswith('  {"file_path"') for line in text.splitlines()) == 2
    first, second = read_views(tmp_path / "out.json", jnp.float64)
    assert float(first.camera.aperture.radius) == 0
    assert float(second.camera.aperture.radius) == 0.09
    assert (first.mask, second.mask) == (None, tmp_path / "masks/b.png")


def test_frames_of_all_lenses_share_one_file(tmp_path):
    views = [record(camera(lens=name), name, effect=name) for name in LENSES]
    write_manifest(tmp_path / "mixed.json", views)
    read = read_views(tmp_path / "mixed.json", jnp.float64)
    assert [view.effect for view in read] == list(LENSES)
    for view, name in zip(read, LENSES, strict=True):
        assert eqx.tree_equal(view.camera.lens, camera(lens=name).lens)


def test_a_table_of_rays_lies_beside_the_list_once(tmp_path):
    views = [record(camera(lens="table"), name) for name in "ab"]
    write_manifest(tmp_path / "out.json", views)
    (file,) = tmp_path.glob("lens_*.npz")
    assert f'"file": "{file.name}"' in (tmp_path / "out.json").read_text()
    rays = np.asarray(LENSES["table"]().rays)
    np.testing.assert_array_equal(np.load(file)["rays"], rays)


def test_single_precision_is_written_as_short_as_it_is(tmp_path):
    write_manifest(tmp_path / "out.json", [record(camera(kind=jnp.float32))])
    assert '"fl_x": 50.1,' in (tmp_path / "out.json").read_text()


def test_a_written_folder_is_a_capture_that_reads_without_a_warning(tmp_path):
    write_manifest(tmp_path / "transforms.json", [record(camera())])
    names = ("fisheye", "kannala_brandt", "table", "double_sphere", "sphere", "angle_of_radius")
    for name in names:
        write_manifest(tmp_path / f"{name}.json", [record(camera(lens=name), effect=name)])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        capture = read_capture(tmp_path)
    assert len(capture.views) == 1 and set(capture.effects) == set(names)


def test_what_cannot_be_written_is_said(tmp_path):
    path = tmp_path / "out.json"
    with pytest.raises(ValueError, match="out.json: a manifest must list at least one frame"):
        write_manifest(path, [])
    with pytest.raises(ValueError, match=r"extra must not hold the keys of frames, got \['w'\]"):
        write_manifest(path, [record(camera())], extra={"w": 3})
    with pytest.raises(ValueError, match="split must be one of train, test, got 'val'"):
        write_manifest(path, [FrameRecord("a.png", camera(), "a", "val")])
    nan = eqx.tree_at(lambda c: c.time, camera(), jnp.array(jnp.nan))
    with pytest.raises(ValueError, match="every number written must be finite"):
        write_manifest(path, [record(nan)])
    assert not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="file/deep/out.json: its folder cannot be made"):
        write_manifest(tmp_path / "file/deep/out.json", [record(camera())])
