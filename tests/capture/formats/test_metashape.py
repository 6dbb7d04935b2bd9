"""Photographs with the cameras that Metashape exports."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gaussray.camera.camera import project
from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.formats.metashape import read_metashape
from gaussray.capture.open import format_of, open_capture
from gaussray.dataset.images import write_image


# Single precision through lens and pose, in pixels.
PIXELS = 2e-3
W, H = 64, 48
LENS = {"f": 50, "cx": 1.5, "cy": -2.5, "b1": 0.5, "k1": -0.1, "k2": 0.05, "k3": -0.02}
LENS |= {"p1": 0.003, "p2": -0.002}
POSE = np.eye(4)
POSE[:3, :3] = Rotation.from_rotvec([0.2, -0.3, 0.1]).as_matrix()
POSE[:3, 3] = (0.5, -1, 2)


def sensor(lens=LENS, kind="frame", number=0):
    told = "".join(f"<{key}>{value}</{key}>" for key, value in lens.items())
    size = f'<resolution width="{W}" height="{H}"/>'
    return (
        f'<sensor id="{number}" label="s" type="{kind}">{size}<calibration class="initial"><f>9</f>'
        f'</calibration><calibration class="adjusted">{size}{told}</calibration></sensor>'
    )


def camera(label, pose=POSE, more=""):
    numbers = "" if pose is None else " ".join(map(str, np.ravel(pose)))
    inner = "" if pose is None else f"<transform>{numbers}</transform>"
    return f'<camera id="0" sensor_id="0" label="{label}" {more}>{inner}</camera>'


def lay(folder, cameras, sensors=None, extra=""):
    (folder / "cameras.xml").write_text(
        f'<?xml version="1.0"?><document version="2.0.0"><chunk label="Chunk 1">'
        f"<sensors>{sensors or sensor()}</sensors><cameras>{cameras}</cameras>{extra}</chunk>"
        "</document>"
    )


@pytest.fixture
def folder(tmp_path):
    for name in ("images/a.PNG", "images/x/b.png", "c.png"):
        (tmp_path / name).parent.mkdir(exist_ok=True, parents=True)
        write_image(tmp_path / "x.png", np.full((H, W, 3), 128, np.uint8))
        (tmp_path / "x.png").rename(tmp_path / name)
    return tmp_path


def points(pose=POSE, seed=0):
    """Points before a camera, in the world and in Metashape's camera axes (+z forward)."""
    own = np.random.default_rng(seed).uniform((-0.6, -0.4, 1), (0.6, 0.4, 1), (20, 3)) * 3
    return own @ pose[:3, :3].T + pose[:3, 3], own


def pixels(view, world):
    return np.array([project(view.camera, jnp.asarray(x, jnp.float32)) for x in world])


def frame_lens(own, f=0, cx=0, cy=0, b1=0, k1=0, k2=0, k3=0, k4=0, p1=0, p2=0):
    """The frame camera of Metashape's manual."""
    x, y = (own[:, :2] / own[:, 2:]).T
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3 + k4 * r2**4
    u = x * radial + p1 * (r2 + 2 * x**2) + 2 * p2 * x * y
    v = y * radial + p2 * (r2 + 2 * y**2) + 2 * p1 * x * y
    return np.stack([W / 2 + cx + u * (f + b1), H / 2 + cy + v * f], axis=1)


def test_a_point_falls_where_the_manual_puts_it(folder):
    lay(folder, camera("a.PNG"))
    assert format_of(folder) == "metashape"
    (view,) = open_capture(folder).views
    world, own = points()
    np.testing.assert_allclose(pixels(view, world), frame_lens(own, **LENS), atol=PIXELS)
    assert (view.image.name, view.camera_name, view.split) == ("a.PNG", "a", "train")


def test_a_fourth_radial_coefficient_is_met_by_the_other_three(folder):
    lens = {**LENS, "k4": 2.0}
    lay(folder, camera("a.PNG"), sensor(lens))
    (view,) = read_metashape(folder).views
    world, own = points()
    off = np.abs(pixels(view, world) - frame_lens(own, **lens)).max()
    without = np.abs(frame_lens(own, **{**lens, "k4": 0}) - frame_lens(own, **lens)).max()
    assert off < without / 3
    lay(folder, camera("a.PNG"), sensor({"f": 1e-300, "k4": 1}))
    with pytest.raises(ValueError, match="cameras.xml|lens"):
        read_metashape(folder)
    lay(folder, camera("a.PNG"), sensor({**lens, "k4": 40.0}))
    with pytest.warns(
        CaptureWarning,
        match=r"coefficient \(k4\) of 1 of 1 lenses cannot be followed .* up to \d+\.\d off",
    ):
        read_metashape(folder)


def test_a_fisheye_is_equidistant_with_a_polynomial(folder):
    lens = {"f": 30, "k1": 0.02, "k2": -0.01, "k3": 0.003, "k4": -0.001}
    lay(folder, camera("a.PNG"), sensor(lens, "equidistant_fisheye"))
    (view,) = read_metashape(folder).views
    world, own = points()
    flat = np.linalg.norm(own[:, :2], axis=1)
    angle = np.arctan2(flat, own[:, 2])
    radius = angle * (1 + sum(lens[f"k{i}"] * angle ** (2 * i) for i in range(1, 5)))
    expected = np.array([W / 2, H / 2]) + 30 * (radius / flat)[:, None] * own[:, :2]
    np.testing.assert_allclose(pixels(view, world), expected, atol=PIXELS)


def test_what_lenses_lack_here_is_told_once_for_all(folder):
    sensors = (
        sensor({**LENS, "b2": 3.0}) + sensor({**LENS, "b2": -6.0}, number=1) + sensor(number=2)
    )
    cameras = camera("a") + camera("b").replace('sensor_id="0"', 'sensor_id="1"')
    lay(folder, cameras, sensors)
    # A pixel at the upper edge is b2 y / f off.
    with pytest.warns(CaptureWarning) as told:
        read_metashape(folder)
    (message,) = [str(warning.message) for warning in told]
    assert "skew (b2) of 2 of 2 lenses cannot be followed exactly" in message
    assert f"up to {6 * H / 2 / 50:.1f} off" in message
    lay(folder, camera("a"), sensor({"f": 30, "p1": 0.1}, "fisheye"))
    with pytest.warns(CaptureWarning, match="tangential distortion"):
        read_metashape(folder)


def test_a_spherical_picture_has_what_is_ahead_in_its_middle(folder):
    lay(folder, camera("a.PNG"), sensor({}, "spherical"))
    (view,) = read_metashape(folder).views
    world, own = points()
    longitude = np.arctan2(own[:, 0], own[:, 2])
    latitude = np.arctan2(own[:, 1], np.linalg.norm(own[:, [0, 2]], axis=1))
    expected = np.stack([W / 2 + longitude * W / (2 * np.pi), H / 2 + latitude * H / np.pi], axis=1)
    np.testing.assert_allclose(pixels(view, world), expected, atol=PIXELS)


def test_labels_name_pictures_with_or_without_suffix_in_either_folder(folder):
    group = f'<group id="0">{camera("b")}</group>'
    lay(folder, camera("A.png") + group + camera("c") + camera("lost"))
    with pytest.warns(CaptureWarning, match="lost"):
        views = open_capture(folder).views
    found = [view.image.relative_to(folder).as_posix() for view in views]
    assert found == ["images/a.PNG", "images/x/b.png", "c.png"]


def test_cameras_without_pose_and_of_other_components_are_left_out(folder):
    first, other = 'component_id="0"', 'component_id="1"'
    lay(folder, camera("a", more=first) + camera("b", more=first) + camera("c", more=other))
    with pytest.warns(CaptureWarning, match="1 cameras are in other components"):
        assert [view.camera_name for view in read_metashape(folder).views] == ["a", "b"]
    lay(folder, camera("a") + camera("b", None))
    with pytest.warns(CaptureWarning, match="1 of 2 cameras have no pose"):
        assert [view.camera_name for view in read_metashape(folder).views] == ["a"]


@pytest.mark.parametrize(
    ("cameras", "sensors", "says"),
    [
        ("", None, "must list cameras with a transform, got none"),
        (camera("a", POSE[:3]), None, "frame 0: transform must be 16 numbers"),
        (camera("a", 2 * POSE + np.diag([0, 0, 0, -1])), None, "without scale"),
        (
            camera("a"),
            sensor(kind="equisolid_fisheye"),
            r"sensor 0 \(s\): type must be frame, fisheye",
        ),
        (camera("a"), sensor({**LENS, "k1": "x"}), "k1 must be a finite number, got 'x'"),
        (camera("a"), sensor({**LENS, "f": 0}), "f must be above 0, got 0.0"),
        (camera("a"), sensor({**LENS, "f": "nan"}), "f must be a finite number"),
        (camera("a"), sensor(number=7), "sensor_id must be that of a sensor of the file, got '0'"),
        (camera("a") + camera("a"), None, "a label of its own, got 'a' 2 times"),
        (camera("a") + "<", None, "cameras.xml: must be XML, got"),
    ],
)
def test_what_contradicts_the_format_is_refused_by_name(folder, cameras, sensors, says):
    lay(folder, cameras, sensors)
    with pytest.raises(CaptureError, match=says):
        read_metashape(folder)


def test_entities_and_several_chunks_are_refused(folder):
    lay(folder, camera("a"), extra="</chunk><chunk><cameras/>")
    with pytest.raises(CaptureError, match="must hold one chunk with cameras, got 2"):
        read_metashape(folder)
    path = folder / "cameras.xml"
    path.write_text('<!DOCTYPE a [<!ENTITY b "c">]>' + path.read_text()[21:])
    with pytest.raises(CaptureError, match="must not declare entities"):
        read_metashape(folder)
    path.unlink()
    with pytest.raises(FileNotFoundError, match="Export Cameras"):
        read_metashape(folder)


def test_cameras_whose_labels_are_folders_film_what_is_in_them(tmp_path):
    lay(tmp_path, camera("1") + camera("cam2.jpg"))
    for name in ("1", "cam2"):
        for number in (9, 10, 11)[: 3 if name == "1" else 2]:
            path = tmp_path / "images" / name / f"f_{number}.png"
            path.parent.mkdir(exist_ok=True, parents=True)
            write_image(path, np.full((H, W, 3), number, np.uint8))
    capture = open_capture(tmp_path)
    shown = {(view.camera_name, round(3 * view.time)): view.image.name for view in capture.views}
    first = {("1", k): f"f_{9 + k}.png" for k in range(3)}
    assert shown == {**first, ("cam2", 0): "f_9.png", ("cam2", 1): "f_10.png"}
    poses = np.array([view.camera.trajectory.translation[0] for view in capture.views])
    np.testing.assert_allclose(poses, np.tile(POSE[:3, 3], (5, 1)), rtol=1e-6)


def test_a_label_must_not_lead_out_of_the_folder(tmp_path):
    (tmp_path / "in").mkdir()
    lay(tmp_path / "in", camera("../1"))
    with pytest.raises(CaptureError, match="must name a file in|have no picture"):
        open_capture(tmp_path / "in")
