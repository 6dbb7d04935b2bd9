"""Lenses of every kind: textbook formulas, inverses, rims, poles, and what is behind the camera."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from lenses import BENT, HALF, PRISM, TILT, any_way, assert_slopes, moved, number, sloped, zoo

from gaussray.camera.lens import (
    DoubleSphere,
    Equirectangular,
    Fisheye,
    FTheta,
    Pinhole,
    RadialLens,
    RayTable,
    ThinPrismFisheye,
    UnifiedSphere,
    check_lens,
    limit_of_angle,
    pinhole,
)


WIDTH, HEIGHT = 96, 64
# Root finding ends in a Newton step whose error is at rounding: 1e-16 of 100 px, times headroom.
EXACT_PX = 1e-6
# 24 bits over 100 px are 1e-5 px; a few operations and steep places near rims make it 1e-2.
SINGLE_PX = 2e-2
# Central differences in double precision (steps of 1e-5 and 1e-6) of values of order 100.
GRADIENT = {"rtol": 1e-4, "atol": 1e-4}
LENSES = zoo(WIDTH, HEIGHT)
every_lens = pytest.mark.parametrize("name", LENSES)
PROBES = jnp.array([[31.3, 42.1]])
SIDES = jnp.array([(x, y, z) for x in (0.0, 1, -1) for y in (0.0, 1, -1) for z in (0.0, 1, -1)])


def pixel_centers(step=1):
    column, row = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    return jnp.asarray(np.stack([column, row], -1).reshape(-1, 2)[::step])


# Rows of what is compiled for each lens: pixels on a grid that meets every column, and the points.
ROWS = 400


def filled(x):
    """As many rows as all have, the last again and again."""
    return jnp.concatenate([x, jnp.broadcast_to(x[-1:], (ROWS - len(x), x.shape[1]))])


def seen(lens, pixels, points):
    """What is seen at pixels and points, by the one program that is compiled for a lens."""
    pixels, points = filled(pixels), filled(points)
    still = jax.tree.map(jnp.zeros_like, (lens, pixels, points))
    (direction, *_), (pixel, *_) = sloped(lens, pixels, points, still)
    return np.asarray(direction), np.asarray(pixel)


@jax.jit
def there_and_back(lens, pixels, distance):
    direction = jax.vmap(lens.direction)(pixels)
    return direction, jax.vmap(lens.project)(direction * distance)


@jax.jit
def image(lens, points):
    return jax.vmap(lens.project)(points)


@jax.jit
def look(lens, pixels):
    return jax.vmap(lens.direction)(pixels)


@pytest.mark.ci
@every_lens
def test_direction_and_project_are_each_others_inverse_at_any_distance(name):
    lens, pixels = LENSES[name], filled(pixel_centers(17))
    distance = jnp.linspace(0.01, 1e4, ROWS)[:, None]
    direction, _ = seen(lens, pixels, jnp.ones((1, 3)))
    _, back = seen(lens, pixels, direction * distance)
    again, _ = seen(lens, jnp.nan_to_num(back, nan=-1e4), jnp.ones((1, 3)))
    lit = np.any(direction != 0, axis=-1)
    assert lit.mean() > 0.5
    np.testing.assert_allclose(np.linalg.norm(direction[lit], axis=-1), 1, atol=1e-12)
    assert np.abs(back - pixels)[lit].max() < EXACT_PX
    np.testing.assert_allclose(again[lit], direction[lit], atol=1e-9)
    assert np.isnan(back[~lit]).all()


COSTLY = ("thin_prism", "thin_prism_fisheye", "table")


@pytest.mark.parametrize(
    "name", [pytest.param(x, marks=pytest.mark.slow if x in COSTLY else ()) for x in LENSES]
)
def test_single_precision_stays_single_and_near(name):
    lens, pixels = jax.tree.map(lambda x: x.astype(jnp.float32), (LENSES[name], pixel_centers()))
    direction, back = there_and_back(lens, pixels, jnp.float32(3))
    assert direction.dtype == back.dtype == jnp.float32
    # The rim itself may round to either side.
    lit = np.any(direction != 0, axis=-1) & np.all(np.isfinite(back), axis=-1)
    assert lit.mean() > 0.5
    assert np.abs(back - pixels)[lit].max() < SINGLE_PX


def opencv(x, y, z):
    """OpenCV's calib3d, written out: distortion, thin prism, and the tilt's homography."""
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = PRISM
    x, y = x / z, y / z
    r2 = x**2 + y**2
    radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2) + s1 * r2 + s2 * r2**2
    yd = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y + s3 * r2 + s4 * r2**2
    return np.stack([xd, yd])


def tilted(x, y, z):
    tx, ty = TILT
    about_x = [[1, 0, 0], [0, np.cos(tx), np.sin(tx)], [0, -np.sin(tx), np.cos(tx)]]
    about_y = [[np.cos(ty), 0, -np.sin(ty)], [0, 1, 0], [np.sin(ty), 0, np.cos(ty)]]
    turn = np.array(about_y) @ np.array(about_x)
    flat = [[turn[2, 2], 0, -turn[0, 2]], [0, turn[2, 2], -turn[1, 2]], [0, 0, 1]]
    xd, yd = opencv(x, y, z)
    seen = np.array(flat) @ turn @ np.stack([xd, yd, np.ones_like(xd)])
    return seen[:2] / seen[2]


def around(radius):
    """An image from r(theta), with the azimuth as an angle."""

    def image(x, y, z):
        theta, phi = np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)
        return radius(theta) * np.stack([np.cos(phi), np.sin(phi)])

    return image


def unified(alpha, beta):
    def image(x, y, z):
        d = np.sqrt(beta * (x**2 + y**2) + z**2)
        return np.stack([x, y]) / (alpha * d + (1 - alpha) * z)

    return image


def double_sphere(x, y, z, xi=-0.2, alpha=0.6):
    d1 = np.sqrt(x**2 + y**2 + z**2)
    d2 = np.sqrt(x**2 + y**2 + (xi * d1 + z) ** 2)
    return np.stack([x, y]) / (alpha * d2 + (1 - alpha) * (xi * d1 + z))


def thin_prism_fisheye(x, y, z):
    """COLMAP's models.h: the equidistant point, then what is added to it."""
    k1, k2, p1, p2, k3, k4, sx1, sy1 = BENT
    r = np.hypot(x, y)
    theta = np.arctan2(r, z)
    u, v = x * theta / r, y * theta / r
    t2 = theta**2
    radial = k1 * t2 + k2 * t2**2 + k3 * t2**3 + k4 * t2**4
    du = u * radial + 2 * p1 * u * v + p2 * (t2 + 2 * u**2) + sx1 * t2
    dv = v * radial + 2 * p2 * u * v + p1 * (t2 + 2 * v**2) + sy1 * t2
    return np.stack([u + du, v + dv])


def sphere(x, y, z):
    """Longitude and latitude in half turns."""
    return np.stack([np.arctan2(x, z), np.arcsin(y / np.sqrt(x**2 + y**2 + z**2))]) / np.pi


def angle_of_radius(theta):
    """By a table of the polynomial, finer than what is asked."""
    r = np.linspace(0, 3, 300_001)
    k = np.asarray(LENSES["angle_of_radius"].coefficients)
    return np.interp(theta, np.polynomial.polynomial.polyval(r, k)[: 2 * 10**5], r[: 2 * 10**5])


FORMULAS = {
    "thin_prism": opencv,
    "tilted": tilted,
    "equidistant": around(lambda theta: theta),
    "equisolid": around(lambda theta: 2 * np.sin(theta / 2)),
    "stereographic": around(lambda theta: 2 * np.tan(theta / 2)),
    "orthographic": around(np.sin),
    "unified": unified(0.6, 1.0),
    "enhanced": unified(0.55, 1.2),
    "double_sphere": double_sphere,
    "thin_prism_fisheye": thin_prism_fisheye,
    "radius_of_angle": around(lambda t: 1.1 * t + 0.02 * t**2 - 0.01 * t**3),
    "angle_of_radius": around(angle_of_radius),
    "sphere": sphere,
    "part_of_the_sphere": sphere,
}


@pytest.mark.parametrize("name", FORMULAS)
def test_points_all_around_fall_where_the_textbook_says(name):
    lens = LENSES[name]
    points = np.random.default_rng(0).normal(size=(400, 3))
    if isinstance(lens, Pinhole):
        points[:, :2] = 0.4 * points[:, 2:] * np.tanh(points[:, :2])  # far out it folds
    theta = np.arccos(points[:, 2] / np.linalg.norm(points, axis=1))
    half = np.pi / 2 if isinstance(lens, Pinhole) else HALF.get(name, np.pi)
    expected = FORMULAS[name](*points.T)
    expected = np.asarray(lens.center) + np.asarray(lens.focal) * expected.T
    expected[theta > half] = np.nan
    found = image(lens, jnp.asarray(points))
    # The interpolated polynomial is exact to (1e-5)^2.
    np.testing.assert_allclose(found, expected, atol=1e-7 if name == "angle_of_radius" else 1e-10)
    behind = np.isfinite(expected).all(axis=1) & (theta > np.pi / 2)
    assert behind.any() == (half > np.pi / 2)


def test_mei_and_usenko_agree_where_their_spheres_are_one():
    center, half = jnp.zeros(2), number(1.8)
    points = jnp.asarray(np.random.default_rng(1).normal(size=(50, 3)))
    one = UnifiedSphere(jnp.ones(2), center, jnp.array([0.6, 1.0]), half)
    two = DoubleSphere(jnp.ones(2), center, jnp.array([0.0, 0.6]), half)
    np.testing.assert_allclose(image(one, points), image(two, points), atol=1e-12)
    flat = UnifiedSphere(jnp.ones(2), center, jnp.array([0.0, 1.0]), number(1.2))
    np.testing.assert_allclose(
        image(flat, points), np.where((np.isfinite(image(flat, points))),
        image(pinhole(jnp.ones(2), center), points), np.nan), atol=1e-12,
    )  # fmt: skip


@jax.jit
def on_axis(lens, pixel):
    value = lens.direction(pixel)
    slopes = [jacobian(lens.direction)(pixel) for jacobian in (jax.jacrev, jax.jacfwd)]
    return value, slopes, jax.jacrev(lens.project)(jnp.array([0.0, 0.0, 2.0]))


@pytest.mark.parametrize("name", [k for k, lens in LENSES.items() if isinstance(lens, RadialLens)])
def test_on_the_axis_value_and_jacobian_are_the_limits(name):
    lens = LENSES[name]
    value, slopes, back = on_axis(lens, lens.center)
    np.testing.assert_allclose(value, [0, 0, 1], atol=1e-12)
    paraxial = {"double_sphere": 1 / 0.8, "radius_of_angle": 1.1, "angle_of_radius": 1 / 0.9}
    focal = np.asarray(lens.focal) * paraxial.get(name, 1)
    expected = np.zeros((3, 2))
    expected[:2] = np.diag(1 / focal)
    for slope in slopes:
        np.testing.assert_allclose(slope, expected, atol=1e-12)
    np.testing.assert_allclose(back[:, :2], np.diag(0.5 * focal), rtol=1e-9)
    np.testing.assert_allclose(back[:, 2], 0, atol=1e-12)


def rims(lens):
    """Pixels on the rim, just inside and outside, and the axis."""
    if not isinstance(lens, RadialLens):
        return lens.center[None]
    r = lens.radius(lens.max_angle) * jnp.array([0, 1 - 1e-9, 1, 1 + 1e-9])
    angle = jnp.linspace(0, 2 * jnp.pi, 9)
    side = jnp.stack([jnp.cos(angle), jnp.sin(angle)], -1)
    return lens.center[None] + lens.focal[None] * (r[:, None, None] * side[None]).reshape(-1, 2)


@every_lens
def test_gradients_are_finite_everywhere_and_those_of_finite_differences_in_every_parameter(name):
    """In the picture, on rim, axis and poles, and all around."""
    lens = LENSES[name]
    pixels = filled(jnp.concatenate([PROBES, pixel_centers(37), rims(lens)]))
    aside = isinstance(lens, Pinhole | ThinPrismFisheye | RayTable) or name == "orthographic"
    point = jnp.array([[0.31, -0.22, 1.1] if aside else [1.1, -0.5, -0.1]])
    points = filled(jnp.concatenate([point, SIDES, 1e-9 * SIDES]))
    whole = lens, pixels, points
    way = any_way(*whole)
    found = sloped(*whole, way)
    for _, along, back in found:
        assert all(np.isfinite(x).all() for x in jax.tree.leaves((along, back)))
    for i, step in enumerate((1e-5, 1e-6)):
        before, after = (sloped(*moved(whole, way, s), way)[i] for s in (-step, step))
        assert_slopes(found[i], before, after, (way[0], way[i + 1]), step, 1, **GRADIENT)


def test_straight_behind_is_no_pixel_of_a_fisheye_and_a_column_of_the_sphere():
    whole = Fisheye(jnp.ones(2), jnp.zeros(2), number(np.pi), "equidistant")
    behind = jnp.array([[0.0, 0, -1], [1e-6, 0, -1]])
    seen = np.asarray(image(whole, behind))
    assert np.isnan(seen[0]).all() and seen[1] == pytest.approx([np.pi, 0], abs=1e-5)
    sphere = LENSES["sphere"]
    seen = np.asarray(image(sphere, behind))
    assert abs(seen[0, 0] - WIDTH / 2) == pytest.approx(WIDTH / 2)
    np.testing.assert_allclose(seen[:, 1], HEIGHT / 2, atol=1e-9)


def test_the_sphere_has_its_poles_at_the_edges_and_up_is_up():
    sphere = LENSES["sphere"]
    ends = look(sphere, jnp.array([[10.0, 0], [70.0, HEIGHT], [0, 32], [24, 32], [48, 32]]))
    expected = [[0, -1, 0], [0, 1, 0], [0, 0, -1], [-1, 0, 0], [0, 0, 1]]
    np.testing.assert_allclose(ends, expected, atol=1e-12)
    poles = image(sphere, jnp.array([[0.0, -2, 0], [0, 3, 0]]))
    np.testing.assert_allclose(poles, [[48, 0], [48, 64]], atol=1e-9)
    # Every pixel is a patch of the sphere: solid angles cos(latitude) sum to 4 pi.
    direction = np.asarray(look(sphere, pixel_centers()))
    patch = np.hypot(direction[:, 0], direction[:, 2]) * 2 * np.pi / WIDTH * np.pi / HEIGHT
    assert patch.sum() == pytest.approx(4 * np.pi, rel=1e-3)


def test_equal_solid_angles_are_equal_areas_of_an_equisolid_picture():
    lens = LENSES["equisolid"]
    pixels = jnp.array([[50.0, 31.0], [30.0, 40.0], [70.0, 20.0]])
    areas = []
    for turn in jax.vmap(jax.jacfwd(lens.direction))(pixels):
        areas.append(np.linalg.norm(np.cross(turn[:, 0], turn[:, 1])))
    np.testing.assert_allclose(areas, 1 / np.prod(np.asarray(lens.focal)), rtol=1e-9)


CENTER, FOCAL = jnp.array([48.0, 32.0]), jnp.array([30.0, 30.0])


def radial(kind, k, half, *more):
    return lambda: kind(FOCAL, CENTER, jnp.array(k), number(half), *more)


@pytest.mark.parametrize(
    "build, message",
    [
        (lambda: pinhole(FOCAL, CENTER, jnp.ones(9)), "lens.distortion must hold (8, 12, 14) co"),
        (
            lambda: pinhole(FOCAL, CENTER, jnp.zeros(14).at[12].set(1.6)),
            "lens.distortion (tilt) must be within +-pi/2, got [1.6, 0.0]",
        ),
        (lambda: Fisheye(FOCAL, CENTER, number(1), "cubic"), "lens.model must be one of equidist"),
        (
            lambda: Fisheye(FOCAL, CENTER, number(1.6), "orthographic"),
            "lens.max_angle must be in (0, 1.570796] here, got 1.6",
        ),
        (
            lambda: Fisheye(FOCAL, CENTER, number(np.pi), "stereographic"),
            "lens.max_angle must be in (0, 3.110177] here",
        ),
        (radial(UnifiedSphere, [1.1, 1.0], 1.0), "lens.k (alpha) must be in [0, 1], got 1.1"),
        (radial(UnifiedSphere, [0.4, 0.0], 1.0), "lens.k (beta) must be above 0, got 0.0"),
        (radial(UnifiedSphere, [0.4, 1.0], 2.4), "lens.k must be monotone: r(theta) may not turn"),
        (radial(DoubleSphere, [-1.0, 0.5], 1.0), "lens.k (xi) must be in (-1, 1], got -1.0"),
        (radial(DoubleSphere, [-0.2, 0.6], 3.0), "lens.k must be monotone: r(theta) may not turn"),
        (radial(ThinPrismFisheye, [0.0] * 8, 4.0), "lens.max_angle must be in (0, pi], got 4.0"),
        (radial(FTheta, [0.1, 1.0], 1.0), "lens.k must be 0 first, then above 0, got [0.1, 1.0]"),
        (radial(FTheta, [0.0], 1.0), "lens.k must hold 2 to 7 coefficients, k0 first, got 1"),
        (radial(FTheta, [0.0, 1.0], 1.0, "both"), "lens.polynomial must be one of angle_of_radi"),
        (radial(FTheta, [0.0, 1.0, -1.0], 0.6), "lens.k must be monotone: the polynomial may not"),
        (radial(FTheta, [0.0, 1.0], 4.0), "lens.fov must be <= 2 pi, got 8.0"),
        (
            lambda: limit_of_angle([0.0, 1.0, -1.0], 0.3, "angle_of_radius"),
            "lens.k must reach half of lens.fov (0.3 radians)",
        ),
        (
            lambda: Equirectangular(jnp.array([-1.0, 1.0]), CENTER),
            "lens.focal must be above 0, got [-1.0, 1.0]",
        ),
        (
            lambda: check_lens(Equirectangular(jnp.array([47.0, 64.0]), CENTER), WIDTH, HEIGHT),
            "lens.focal must give every pixel a direction of its own, got none or another pixel's",
        ),
    ],
)
def test_what_is_no_lens_is_refused_by_key_and_rule(build, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        build()


# The others are choices of `lens`, all of which test_rig.py has checked.
def test_a_lens_of_captures_passes_the_check_of_its_picture():
    check_lens(LENSES["thin_prism_fisheye"], WIDTH, HEIGHT)


@pytest.mark.parametrize(("projection", "rim"), [("equisolid", 2.0), ("orthographic", 1.0)])
def test_slopes_keep_their_digits_up_to_the_rim(projection, rim):
    radius = np.float32(rim * (1 - np.array([1e-2, 1e-4, 1e-6])))
    lens = Fisheye(jnp.ones(2), jnp.zeros(2), number(1.5), projection)
    slope = jax.vmap(jax.grad(lens.angle))
    truth = slope(jnp.asarray(radius, float))
    np.testing.assert_allclose(slope(jnp.asarray(radius)), truth, rtol=2e-6)
