"""What cameras focus on: a wall at a known distance, in scenes of any unit."""

import dataclasses

import equinox as eqx
import numpy as np
import pytest
import toy

from gaussray.camera.aperture import Aperture
from gaussray.camera.lens import Fisheye
from gaussray.render.focus import FocusMeter, focus_distances
from gaussray.render.options import RenderOptions
from gaussray.render.renderer import Renderer
from gaussray.render.rig.aperture import ApertureOptions, build_aperture, resolve_aperture
from gaussray.scene.scene import Scene


# The wall is a thousandth thick; lengths are single precision.
THICK, ROUNDED = 2e-3, 1e-5
WALL = 4.0
EMPTY = toy.gaussians(np.zeros((0, 3)), 0.1, [0.5, 0.5, 0.5])


def wall(unit=1.0, hole=0.0):
    """A wall 4 in front of the toy's camera, with a square hole in its middle."""
    x, y = np.meshgrid(*2 * [np.arange(-3, 3.01, 0.15)])
    x, y = (side[np.maximum(abs(x), abs(y)) >= hole] for side in (x, y))
    shade = np.stack([0.5 + 0.4 * np.sin(5 * x), 0.5 + 0.4 * np.sin(7 * y), 0.3 + 0 * x], axis=-1)
    # Not quite even, so that the order of neighbours along a ray is no matter of rounding.
    depth = WALL - 3 + 1e-3 * np.sin(37 * x + 91 * y)
    flat = toy.gaussians(np.stack([x, y, depth], axis=-1), 0.15, shade, 0.99)
    thin = flat.scale.at[:, 2].multiply(1e-2)
    flat = dataclasses.replace(flat, mean=unit * flat.mean, scale=unit * thin)
    return Scene(flat, EMPTY, None, toy.single([0, 1]))


def camera(unit=1.0, size=24):
    found = toy.camera(width=size, height=size)
    return eqx.tree_at(lambda c: c.trajectory.translation, found, replace_fn=lambda x: unit * x)


def meter(scene):
    return FocusMeter(scene, toy.TRACE)


def test_the_focus_is_the_distance_of_a_wall():
    assert meter(wall()).subject_distance(camera(), "plane") == pytest.approx(WALL, rel=THICK)
    # On a sphere it is the distance along the ray, which is hardly longer in the middle.
    found = meter(wall()).subject_distance(camera(), "sphere")
    assert found == pytest.approx(WALL, rel=THICK + 0.01)


def test_pictures_of_any_size_have_one_focus():
    small, large = (meter(wall()).subject_distance(camera(size=n), "plane") for n in (24, 300))
    assert small == pytest.approx(large, rel=THICK)


def test_a_picture_with_nothing_in_the_middle_focuses_on_the_rest_and_an_empty_one_is_refused():
    found = meter(wall(hole=1.0)).subject_distance(camera(), "plane")
    assert found == pytest.approx(WALL, rel=THICK)
    away = eqx.tree_at(lambda c: c.trajectory.translation, camera(), toy.single([[0, 0, 50]]))
    with pytest.raises(ValueError, match="aperture.focus_distance=auto needs a surface"):
        meter(wall()).subject_distance(away, "plane")
    assert meter(wall()).blur(away, 0.5) == 0


def test_aperture_and_shutter_of_the_camera_do_not_count():
    lens = Aperture(toy.single(0.5), toy.single(1), toy.single(0), toy.single(1))
    shutter = dataclasses.replace(camera().shutter, row_step=toy.single(0.1))
    other = dataclasses.replace(camera(), aperture=lens, shutter=shutter)
    plain, found = (meter(wall()).subject_distance(c, "plane") for c in (camera(), other))
    assert plain == found


def test_a_scene_ten_times_as_large_has_the_same_picture():
    """Ten times the focus distance and ten times the radius."""
    pictures, lengths = [], []
    given = ApertureOptions("3.6%", rim_radius="3.6%", rim_distance="6%")
    for unit in (1.0, 10.0):
        scene, seen = wall(unit), camera(unit)
        options = resolve_aperture(given, lambda: meter(scene).subject_distance(seen, "plane"))  # noqa: B023
        aperture = build_aperture(seen, options)
        lengths.append([options.focus_distance, options.radius, options.rim_distance])
        blurred = dataclasses.replace(seen, aperture=aperture)
        render = Renderer(scene, options=RenderOptions(samples=4), trace=toy.TRACE)
        pictures.append(render(blurred).color)
    np.testing.assert_allclose(lengths[1], 10 * np.array(lengths[0]), rtol=1e-9)
    np.testing.assert_allclose(lengths[0], [WALL, 0.036 * WALL, 0.06 * WALL], rtol=5e-3)
    assert pictures[0].std() > 0.01
    np.testing.assert_allclose(pictures[1], pictures[0], atol=2e-3)


def test_blur_is_that_of_the_formula():
    """c = 2 R F |1/f - 1/z| for a wall at z; pixels of the whole picture, not of the small one."""
    radius, focus = 0.2, 2.0
    opened = Aperture(toy.single(radius), toy.single(focus), toy.single(0), toy.single(1))
    for size in (24, 300):
        seen = dataclasses.replace(camera(size=size), aperture=opened)
        expected = 2 * radius * 1.1 * size * abs(1 / focus - 1 / WALL)
        for share in (0.1, 0.5, 0.9):
            assert meter(wall()).blur(seen, share) == pytest.approx(expected, rel=0.01)


def test_focus_distances_are_depths_or_lengths_and_nan_without_a_surface():
    seen, pixel = camera(size=16), np.array([[0.0, 8.0], [8.0, 8.0], [8.0, 8.0]])
    alpha, distance = np.array([1.0, 0.4, 1.0]), np.array([2.0, 2.0, 0.0])
    axis = float(seen.lens.direction(toy.single([0.5, 8.5]))[2])
    plane = focus_distances(seen, "plane", pixel, alpha, distance)
    np.testing.assert_allclose(plane, [2 * axis, np.nan, np.nan], rtol=ROUNDED)
    sphere = focus_distances(seen, "sphere", pixel, alpha, distance)
    np.testing.assert_allclose(sphere, [2, np.nan, np.nan], rtol=ROUNDED)


def test_a_fisheye_focuses_on_a_sphere():
    half, middle = toy.single(2.0), toy.single([12, 12])
    lens = Fisheye(toy.single([8, 8]), middle, half, "equidistant")
    seen = dataclasses.replace(camera(), lens=lens)
    found = meter(wall()).subject_distance(seen, "sphere")
    assert found == pytest.approx(WALL, rel=0.02)
