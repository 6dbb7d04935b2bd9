"""The division model: Fitzgibbon's formula, its inverse, its limits, and its way through files."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy
from jax.test_util import check_grads

from gaussray.calibrate.parameters import (
    corrected_camera,
    prepare_lens,
    reported_values,
    unit_camera_set,
    unknowns,
)
from gaussray.camera.film import Film
from gaussray.camera.lens import Pinhole, check_lens, pinhole
from gaussray.camera.lens.division import Division, fold_radius
from gaussray.capture.formats.paired import read_views
from gaussray.dataset.manifest import FrameRecord, write_manifest
from gaussray.render.rig.lens import LensOptions, build_lens, lens_label
from gaussray.viewer.controls import offered_choices


# Closed forms in double precision; roots are polished by Newton.
EXACT = 1e-9
GRADIENT = 1e-5
FOCAL, CENTER = jnp.array([40.0, 42.0]), jnp.array([31.0, 25.5])


def lens(*k, limit=1.4):
    return Division(FOCAL, CENTER, jnp.array(k), jnp.array(limit))


LENSES = {
    "barrel": lens(-0.3),
    "pincushion": lens(0.2),
    "none": lens(0.0),
    "two": lens(-0.25, 0.03),
    "two_beyond_90_degrees": lens(-0.6, -0.05, limit=1.6),
    "one_beyond_90_degrees": lens(-0.8, limit=1.9),
}
every = pytest.mark.parametrize("name", LENSES)
look = jax.jit(lambda lens, pixel: jax.vmap(lens.direction)(pixel))
radii = jax.jit(lambda lens, theta: jax.vmap(lens.radius)(theta))
image = jax.jit(lambda lens, point: jax.vmap(lens.project)(point))


def pixels(lens, share=0.98):
    """Places all over the picture, on the axis, and close to the rim."""
    r = share * float(lens.limit) * np.array([0, 1e-6, 0.1, 0.5, 0.8, 1.0])
    angle = np.linspace(0, 2 * np.pi, 7)
    xy = r[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], -1)
    return lens.center[None] + lens.focal[None] * jnp.asarray(xy.reshape(-1, 2))


@every
def test_the_ray_of_a_pixel_is_fitzgibbons(name):
    lens = LENSES[name]
    place = pixels(lens)
    x, y = ((np.asarray(place) - np.asarray(lens.center)) / np.asarray(lens.focal)).T
    square, k = x * x + y * y, [*np.asarray(lens.coefficients), 0.0]
    z = 1 + k[0] * square + k[1] * square**2
    expected = np.stack([x, y, z], -1)
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(look(lens, place), expected, atol=EXACT)
    assert (z.min() < 0) == ("beyond" in name)


@every
def test_direction_and_project_are_each_others_inverse(name):
    lens = LENSES[name]
    place = pixels(lens)
    distance = jnp.linspace(0.01, 1e4, len(place))[:, None]
    np.testing.assert_allclose(image(lens, distance * look(lens, place)), place, atol=1e-6)


@every
def test_the_distorted_radius_is_the_first_that_a_search_finds(name):
    lens = LENSES[name]
    r = np.linspace(0, float(lens.limit), 200_001)
    k = [*np.asarray(lens.coefficients), 0.0]
    theta = np.arctan2(r, 1 + k[0] * r**2 + k[1] * r**4)
    angles = np.linspace(0, 0.999 * theta[-1], 25)
    found = radii(lens, jnp.asarray(angles))
    # Linear interpolation between steps of 1e-5.
    np.testing.assert_allclose(found, np.interp(angles, theta, r), atol=1e-8)


@pytest.mark.parametrize("name", ["barrel", "two"])
def test_on_the_axis_direction_and_jacobian_are_the_pinholes(name):
    lens = LENSES[name]
    slope = np.zeros((3, 2))
    slope[:2] = np.diag(1 / np.asarray(FOCAL))
    for jacobian in (jax.jacrev, jax.jacfwd):
        np.testing.assert_allclose(jax.jit(jacobian(lens.direction))(CENTER), slope, atol=EXACT)
    back = jax.jit(jax.jacrev(lens.project))(jnp.array([0.0, 0.0, 2.0]))
    np.testing.assert_allclose(back[:, :2], np.diag(FOCAL / 2), atol=1e-6)


def test_without_coefficients_it_is_a_pinhole():
    place = pixels(LENSES["none"])
    np.testing.assert_allclose(
        look(LENSES["none"], place), look(pinhole(FOCAL, CENTER), place), atol=EXACT
    )


@pytest.mark.parametrize("name", ["barrel", "pincushion", "two", "one_beyond_90_degrees"])
def test_gradients_in_coefficients_pixel_and_point(name):
    lens, pixel = LENSES[name], CENTER + jnp.array([21.0, -13.0])

    @jax.jit
    def direction(k, pixel):
        changed = dataclasses.replace(lens, coefficients=jnp.asarray(k))
        return changed.direction(jnp.asarray(pixel))

    @jax.jit
    def project(k, point):
        changed = dataclasses.replace(lens, coefficients=jnp.asarray(k))
        return changed.project(jnp.asarray(point)) / 40

    check_grads(direction, (lens.coefficients, pixel), 1, ("rev",), GRADIENT, GRADIENT)
    point = jnp.array([0.5, -0.3, 1.1])
    check_grads(project, (lens.coefficients, point), 1, ("rev",), GRADIENT, GRADIENT)


def test_beyond_the_limit_it_is_black():
    lens = LENSES["barrel"]
    rim = lens.center[None] + lens.focal[None] * lens.limit * jnp.array([[0.999, 0], [1.001, 0]])
    assert np.any(look(lens, rim) != 0, axis=1).tolist() == [True, False]
    beyond = 1.01 * float(lens.max_angle)
    point = jnp.array([[np.sin(beyond), 0.0, np.cos(beyond)]])
    assert np.isnan(image(lens, point)).all()


def test_a_model_that_turns_back_is_refused():
    # d theta / d r = 0 at 1 / sqrt(lambda) and where 1 - lambda1 r^2 - 3 lambda2 r^4 = 0.
    np.testing.assert_allclose(fold_radius(np.array([0.25])), 2)
    np.testing.assert_allclose(fold_radius(np.array([0.0, 1 / 3])), 1)
    assert fold_radius(np.array([-0.3])) == np.inf and fold_radius(np.array([0.0])) == np.inf
    lens(0.25, limit=1.99)
    with pytest.raises(ValueError, match=r"lens.k must be monotone: .* turn back at 2\."):
        lens(0.25, limit=2.01)
    with pytest.raises(ValueError, match="lens.k must hold 1 or 2 coefficients, got 3"):
        lens(0.1, 0.1, 0.1)
    with pytest.raises(ValueError, match="lens.limit must be above 0"):
        lens(0.1, limit=0.0)


@pytest.mark.parametrize("k", [(-0.2,), (0.1,), (-0.2, 0.02)])
def test_the_configuration_spans_the_width_and_fills_the_picture(k):
    film = Film(64, 48)
    options = LensOptions("division", 80.0, k)
    built = build_lens(film, options)
    sides = look(built, jnp.array([[0.0, 24.0], [64.0, 24.0]], jnp.float32))
    np.testing.assert_allclose(np.rad2deg(np.arccos(sides[:, 2])), 40, rtol=1e-5)
    corners = jnp.array([[0.5, 0.5], [63.5, 47.5]], jnp.float32)
    assert np.any(look(built, corners) != 0, axis=1).all()
    assert lens_label(options) == "distortion" and not built.sees_sideways
    with pytest.raises(ValueError, match="lens.k must reach half of lens.fov"):
        build_lens(film, LensOptions("division", 170.0, (0.5,)))


def test_a_manifest_writes_it_and_a_capture_reads_the_same_lens(tmp_path):
    camera = toy.camera()
    single = jax.tree.map(lambda x: x.astype(jnp.float32), lens(-0.31, 0.017))
    camera = dataclasses.replace(camera, lens=single)
    path = tmp_path / "transforms.json"
    write_manifest(path, [FrameRecord("a.png", camera, "a", "test", "distortion")])
    assert json.loads(path.read_text())["lens"]["model"] == "division"
    again = read_views(path)[0].camera.lens
    for a, b in zip(jax.tree.leaves(single), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("more", [{"fov": 1.8}, {}, {"limit": 1.1}])
def test_a_capture_names_its_field_of_view_its_limit_or_neither(tmp_path, more):
    pose = np.eye(4).tolist()
    keys = {"w": 64, "h": 48, "fl_x": 40, "fl_y": 40, "cx": 32, "cy": 24}
    block = {"model": "division", "k": [-0.2], **more}
    frame = {"file_path": "a.png", "transform_matrix": pose, "time": 0.0, "camera": "a"}
    path = tmp_path / "transforms.json"
    path.write_text(json.dumps({**keys, "split": "test", "lens": block, "frames": [frame]}))
    built = read_views(path)[0].camera.lens
    assert isinstance(built, Division)
    check_lens(built, 64, 48)
    expected = {"fov": 0.9, "limit": np.arctan2(1.1, 1 - 0.2 * 1.21)}
    corner = np.hypot(34, 26) / 40
    angle = expected.get(next(iter(more), ""), np.arctan2(corner, 1 - 0.2 * corner**2))
    np.testing.assert_allclose(built.max_angle, angle, rtol=1e-5)


def test_calibration_finds_lambda_from_where_points_are_imaged():
    """Gauss and Newton on the unknowns that `gaussray calibrate` would estimate."""
    truth = jax.tree.map(lambda x: x.astype(jnp.float32), lens(-0.3))
    start = dataclasses.replace(truth, coefficients=jnp.zeros(1, jnp.float32))
    camera = dataclasses.replace(toy.camera(), lens=prepare_lens(start, ("lambda1",)))
    told, unit = unknowns(("focal", "lens"), camera.lens, ("lambda1",)), unit_camera_set(camera)
    assert [one.name for one in told] == ["focal", "center.x", "center.y", "lambda1"]
    points = look(truth, pixels(truth, 0.7).astype(jnp.float32))
    seen = image(truth, points)

    @jax.jit
    def residual(value):
        corrected, _ = corrected_camera(value, camera, unit, told)
        return (jax.vmap(corrected.lens.project)(points) - seen).ravel()

    value = jnp.zeros(4, jnp.float32)
    for _ in range(8):
        step = jnp.linalg.lstsq(jax.jacfwd(residual)(value), residual(value))[0]
        value = value - step
    read = dict(
        zip((one.name for one in told), reported_values(value, camera, unit, told), strict=True)
    )
    np.testing.assert_allclose(read["lambda1"], -0.3, atol=1e-4)
    np.testing.assert_allclose(read["focal"], FOCAL[0], rtol=1e-4)


def test_the_viewer_offers_it():
    assert "division" in offered_choices("lens")
    assert not isinstance(
        build_lens(Film(64, 48), LensOptions("division", 120.0, (-0.2,))), Pinhole
    )
