"""Lenses: against Blender's and OpenCV's formulas, as inverses, on the axis, and where they end."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from lenses import any_way, assert_slopes, moved, sloped

from gaussray.camera.distortion import distort, distort_jacobian
from gaussray.camera.lens import FisheyePolynomial, KannalaBrandt, Pinhole, check_lens, pinhole


WIDTH, HEIGHT = 96, 64
# Root finding ends in a Newton step whose error is at rounding: 1e-16 of 100 px, times headroom.
EXACT_PX = 1e-6
# 24 bits over 100 px are 1e-5 px; a few operations and the angle-to-radius slope make it 1e-3.
SINGLE_PX = 1e-2
# Unit vectors in double precision after at most 30 operations.
UNIT = 1e-12
# Central differences in double precision of values of order 100.
GRADIENT = {"rtol": 1e-4, "atol": 1e-5}


def array(*values, dtype=jnp.float64):
    return jnp.array(values, dtype)


def fisheye(k, fov=3.2, sensor=(36.0, 24.0), shift=(0.0, 0.0)):
    return FisheyePolynomial(
        array(*k), array(*sensor), array(WIDTH, HEIGHT), array(*shift), jnp.array(fov)
    )


FOCAL, CENTER = array(70.0, 65.0), array(47.0, 33.0)
BARREL = array(-0.2, 0.05, 0.002, -0.001, -0.01, 0.01, 0.002, 0.001)
PINCUSHION = array(0.15, 0.02, -0.001, 0.002, 0.0, 0.0, 0.0, 0.0)
LENSES = {
    "pinhole": pinhole(FOCAL, CENTER),
    "barrel": Pinhole(FOCAL, CENTER, BARREL),
    "pincushion": Pinhole(FOCAL, CENTER, PINCUSHION),
    "polynomial": fisheye((0.0, -0.05, -2e-4, -1e-5, -1e-7), shift=(0.07, -0.05)),
    "mirrored": fisheye((0.0, 0.05, 1e-4, 1e-5, 1e-7)),
    "offset": fisheye((-0.02, -0.05, 0.0, 0.0, 0.0)),
    "kannala": KannalaBrandt(
        array(40.0, 41.0), CENTER, array(0.02, -0.003, 0.001, -1e-4), jnp.array(1.8)
    ),
}
every_lens = pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES.keys())


@jax.jit
def look(lens, pixels):
    return jax.vmap(lens.direction)(pixels)


@jax.jit
def image(lens, points):
    return jax.vmap(lens.project)(points)


@jax.jit
def seen(lens, pixels):
    return jax.vmap(lens.sees)(pixels)


def pixel_centers():
    column, row = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    return jnp.asarray(np.stack([column, row], -1).reshape(-1, 2))


@every_lens
def test_project_is_the_inverse_of_direction_at_any_distance(lens):
    pixels = pixel_centers()
    direction = look(lens, pixels)
    lit = np.any(direction != 0, axis=-1)
    assert lit.mean() > 0.5
    distance = jnp.linspace(0.01, 1e4, len(pixels))[:, None]
    error = np.abs(image(lens, direction * distance) - pixels)[lit]
    assert error.max() < EXACT_PX
    np.testing.assert_allclose(np.linalg.norm(direction, axis=-1)[lit], 1, atol=UNIT)


@every_lens
def test_direction_is_the_inverse_of_project(lens):
    pixels = pixel_centers()[::7]
    direction = look(lens, pixels)
    again = look(lens, jnp.nan_to_num(image(lens, direction), nan=-1e4))
    lit = np.any(direction != 0, axis=-1)
    np.testing.assert_allclose(np.array(again)[lit], np.array(direction)[lit], atol=1e-9)


@every_lens
def test_single_precision_stays_single_and_exact_to_a_hundredth_of_a_pixel(lens):
    lens, pixels = jax.tree.map(lambda x: x.astype(jnp.float32), (lens, pixel_centers()))
    direction = look(lens, pixels)
    back = image(lens, direction * 3)
    assert direction.dtype == back.dtype == jnp.float32
    lit = np.any(direction != 0, axis=-1) & np.all(np.isfinite(back), axis=-1)
    assert lit.mean() > 0.5
    assert np.abs(back - pixels)[lit].max() < SINGLE_PX


@pytest.mark.parametrize("fit", ["HORIZONTAL", "VERTICAL"])
def test_pinhole_is_blenders(fit):
    lens_mm, sensor_mm, shift = 35.0, 32.0, (0.1, -0.06)
    reference = WIDTH if fit == "HORIZONTAL" else HEIGHT
    f = lens_mm / sensor_mm * reference
    cx = WIDTH / 2 - shift[0] * reference
    cy = HEIGHT / 2 + shift[1] * reference
    j, i = np.mgrid[:HEIGHT, :WIDTH]
    d = np.stack([(i + 0.5 - cx) / f, -(j + 0.5 - cy) / f, -np.ones(i.shape)], -1).reshape(-1, 3)
    ours = np.array(look(pinhole(array(f, f), array(cx, cy)), pixel_centers())) * (1, -1, -1)
    np.testing.assert_allclose(ours, d / np.linalg.norm(d, axis=-1, keepdims=True), atol=UNIT)


@pytest.mark.parametrize(
    "k, fov, shift",
    [
        ((-1.1735143712967577e-05, -0.019988736953434998, -3.3525322965709175e-06,
          3.099275275886036e-06, -2.6064646454854524e-08), math.pi, (0.0, 0.0)),
        ((0.0, -0.11, -3e-4, 1e-5, -1e-7), 4.4, (0.0, 0.0)),
        ((0.03, -0.06, 1e-4, 0.0, -1e-6), 2.2, (0.1, -0.2)),
        ((0.0, 0.05, 0.0, 0.0, 0.0), 3.0, (0.0, 0.0)),
    ],
    ids=["defaults", "beyond 90 degrees", "shifted", "positive k1"],
)  # fmt: skip
def test_fisheye_polynomial_is_blenders(k, fov, shift):
    width_mm, height_mm = 36.0, 36.0 * HEIGHT / WIDTH
    j, i = np.mgrid[:HEIGHT, :WIDTH]
    x = ((i + 0.5) / WIDTH - 0.5 + shift[0]) * width_mm
    y = (0.5 - (j + 0.5) / HEIGHT + shift[1]) * height_mm
    r = np.sqrt(x**2 + y**2)
    theta = -(k[0] + k[1] * r + k[2] * r**2 + k[3] * r**3 + k[4] * r**4)
    phi = np.arctan2(y, x)
    d = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), -np.cos(theta)], -1)
    d = np.where((np.abs(theta) <= fov / 2)[..., None], d, 0).reshape(-1, 3)
    lens = fisheye(k, fov, (width_mm, height_mm), shift)
    ours = np.array(look(lens, pixel_centers())) * (1, -1, -1)
    np.testing.assert_allclose(ours, d, atol=UNIT)
    # The set of lit pixels is Blender's, and the picture has both kinds where it should.
    assert (np.any(ours != 0, -1) == np.any(d != 0, -1)).all()


@pytest.mark.parametrize("x, y", [(1, 1), (-1, 1), (-1, -1), (1, -1), (1, 0), (0, -1)])
@pytest.mark.parametrize("name", ["polynomial", "kannala", "pinhole", "mirrored"])
def test_a_pixel_looks_to_its_own_side_of_the_axis(name, x, y):
    lens = LENSES[name]
    axis = image(lens, array(0.0, 0.0, 1.0)[None])[0]
    direction = look(lens, (axis + array(7.0 * x, 6.0 * y))[None])[0]
    side = -1 if name == "mirrored" else 1
    np.testing.assert_array_equal(np.sign(np.round(direction[:2], 9)), [side * x, side * y])


@jax.jit
def on_axis(lens, pixel):
    slopes = [jacobian(lens.direction)(pixel) for jacobian in (jax.jacrev, jax.jacfwd)]
    return lens.direction(pixel), *slopes, jax.jacrev(lens.project)(array(0.0, 0.0, 2.0))


def test_on_the_axis_value_and_jacobian_are_the_limits():
    kannala, polynomial = LENSES["kannala"], LENSES["polynomial"]
    mm_per_px = polynomial.sensor / polynomial.resolution
    limits = [
        (LENSES["pinhole"], CENTER, 1 / FOCAL),
        (LENSES["barrel"], CENTER, 1 / FOCAL),
        (kannala, CENTER, 1 / kannala.focal),
        (polynomial, image(polynomial, array(0.0, 0.0, 1.0)[None])[0], 0.05 * mm_per_px),
    ]
    for lens, axis, slope in limits:
        value, reverse, forward, back = on_axis(lens, axis)
        np.testing.assert_allclose(value, [0, 0, 1], atol=UNIT)
        expected = np.zeros((3, 2))
        expected[:2] = np.diag(slope)
        np.testing.assert_allclose(reverse, expected, atol=UNIT)
        np.testing.assert_allclose(forward, expected, atol=UNIT)
        # The projection of an axial point at depth 2: its inverse, halved.
        np.testing.assert_allclose(back[:, :2], np.diag(0.5 / slope), rtol=1e-9)
        np.testing.assert_allclose(back[:, 2], 0, atol=UNIT)


def test_blenders_axial_pixel_looks_along_the_axis_even_with_a_constant_term():
    lens = fisheye((-0.02, -0.05, 0.0, 0.0, 0.0))
    np.testing.assert_array_equal(lens.direction(array(WIDTH / 2, HEIGHT / 2)), [0, 0, 1])


@pytest.mark.parametrize("coefficients", [BARREL, PINCUSHION], ids=["barrel", "pincushion"])
def test_distortion_is_opencvs(coefficients):
    k1, k2, p1, p2, k3, k4, k5, k6 = np.array(coefficients)
    point = np.random.default_rng(0).uniform([-1, -0.7, 1], [1, 0.7, 2], (50, 3))
    x, y = point[:, 0] / point[:, 2], point[:, 1] / point[:, 2]
    r2 = x**2 + y**2
    radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    yd = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    expected = np.stack([FOCAL[0] * xd + CENTER[0], FOCAL[1] * yd + CENTER[1]], -1)
    ours = image(Pinhole(FOCAL, CENTER, coefficients), jnp.asarray(point))
    np.testing.assert_allclose(ours, expected, atol=1e-10)


def test_kannala_brandt_is_opencvs_fisheye():
    lens = LENSES["kannala"]
    k1, k2, k3, k4 = np.array(lens.coefficients)
    point = np.random.default_rng(1).normal(size=(50, 3)) + [0, 0, 1]
    a, b, z = point.T
    r = np.hypot(a, b)
    theta = np.arctan2(r, z)
    theta_d = theta * (1 + k1 * theta**2 + k2 * theta**4 + k3 * theta**6 + k4 * theta**8)
    focal, center = np.array(lens.focal), np.array(lens.center)
    expected = focal * np.stack([theta_d * a / r, theta_d * b / r], -1) + center
    expected = np.where((theta <= 1.8)[:, None], expected, np.nan)
    np.testing.assert_allclose(image(lens, jnp.asarray(point)), expected, atol=1e-10)


def test_an_ideal_pinhole_is_the_distorted_one_with_coefficients_zero():
    ideal, general = pinhole(FOCAL, CENTER), Pinhole(FOCAL, CENTER, jnp.zeros(8))
    assert not ideal.distorted and general.distorted
    assert not pinhole(FOCAL, CENTER, jnp.zeros(8)).distorted
    assert pinhole(FOCAL, CENTER, BARREL).distorted
    pixels = pixel_centers()[::11]
    np.testing.assert_allclose(look(ideal, pixels), look(general, pixels), atol=UNIT)


def test_what_a_lens_does_not_see_is_zero_and_nan():
    for lens in (LENSES["pinhole"], LENSES["barrel"]):
        points = jnp.array([(0.1, 0.2, -1.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0)])
        assert np.isnan(image(lens, points)).all()
    narrow = fisheye((0.0, -0.05, 0.0, 0.0, 0.0), fov=1.2)
    kannala = LENSES["kannala"]
    for lens, corner in ((narrow, array(0.5, 0.5)), (kannala, array(-40.0, 33.0))):
        both = jnp.stack([corner, array(50.0, 30.0)])
        np.testing.assert_array_equal(look(lens, both)[0], 0)
        np.testing.assert_array_equal(seen(lens, both), [False, True])
        points = jnp.array([(0.0, 0.0, -1.0), (0.3, -0.4, -2.0), (0.0, 0.0, 0.0)])
        assert np.isnan(image(lens, points)).all()


def test_the_rim_of_the_field_of_view_belongs_to_the_picture():
    lens = fisheye((0.0, -0.05, 0.0, 0.0, 0.0), fov=1.2)
    rim = 0.6 / 0.05 / 36 * WIDTH  # pixels from the axis
    for sign in (-1, 1):
        inside = array(WIDTH / 2 + sign * (rim - 1e-9), HEIGHT / 2)
        outside = array(WIDTH / 2 + sign * (rim + 1e-9), HEIGHT / 2)
        both = jnp.stack([inside, outside])
        np.testing.assert_array_equal(seen(lens, both), [True, False])
        back = image(lens, look(lens, both))
        np.testing.assert_allclose(back[0], inside, atol=EXACT_PX)


def test_a_wide_lens_sees_behind_the_camera():
    lens = fisheye((0.0, -0.11, 0.0, 0.0, 0.0), fov=5.0)
    assert lens.direction(array(0.5, HEIGHT / 2))[2] < -0.3


def test_folding_distortion_is_black_instead_of_wrong():
    lens = Pinhole(FOCAL, CENTER, array(-0.8, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    direction = np.array(look(lens, pixel_centers()))
    lit = np.any(direction != 0, -1)
    assert 0 < lit.mean() < 1
    back = np.array(image(lens, jnp.asarray(direction)))
    # At the fold itself Newton converges linearly: a thousandth of a pixel instead of rounding.
    np.testing.assert_allclose(back[lit], np.array(pixel_centers())[lit], atol=1e-3)


@pytest.mark.parametrize(
    ("k", "edge"),
    [
        # r (1 + k1 r^2) turns back at sqrt(1 / (-3 k1)), and passes the centre at sqrt(1 / -k1).
        ((-0.8, 0.0), np.sqrt(1 / 2.4)),
        # r (1 - 2 r^2 + 1.5 r^4) falls between the roots of 1 - 6 r^2 + 7.5 r^4, then rises again.
        ((-2.0, 1.5), np.sqrt((6 - np.sqrt(6)) / 15)),
    ],
)
def test_nothing_beyond_the_first_fold_is_in_the_picture(k, edge):
    lens = Pinhole(FOCAL, CENTER, array(*k, *[0.0] * 6))
    radius = np.linspace(0.01, 2.0, 400)
    points = jnp.stack([radius, 0 * radius, 1 + 0 * radius], axis=-1)
    imaged = ~np.isnan(np.array(image(lens, points))).any(axis=-1)
    np.testing.assert_array_equal(imaged, radius < edge)
    direction = np.array(look(lens, pixel_centers()))
    lit = np.any(direction != 0, axis=-1)
    assert lit.any() and np.all(np.hypot(*direction[lit, :2].T) < edge * direction[lit, 2])


# Off the axis, and 1e-3 px from it, where r is small but not zero.
PROBES = [(11.3, 52.1), (80.2, 20.9), (47.001, 33.0)]
POINTS = [(0.3, -0.2, 1.1), (1e-3, 0.0, 2.0)]


@every_lens
def test_gradients_are_finite_everywhere_and_those_of_finite_differences_in_every_parameter(lens):
    """In the picture and on the axis, beside and behind the camera."""
    probes, points = np.array(PROBES), np.array(POINTS)
    if isinstance(lens, FisheyePolynomial):
        probes[2] = 11.3, 33.0  # its axis is elsewhere; a row through the middle instead
    if lens is LENSES["offset"]:
        points[1, 0] = 0.1  # closer to its axis it sees nothing
    axis = jnp.nan_to_num(image(lens, array(0.0, 0.0, 1.0)[None]))
    pixels = jnp.concatenate([probes, axis, pixel_centers()[::17]])
    side = (0.0, 1.0, -1.0)
    around = np.array([(x, y, z) for x in side for y in side for z in side])
    more = np.ones((len(pixels) - len(points) - len(around), 3))
    whole = lens, pixels, jnp.concatenate([points, around, more])
    way = any_way(*whole)
    if isinstance(lens, FisheyePolynomial):
        # k_n in cm^-n instead of mm^-n: finite differences of all five are alike.
        coefficients = way[0].coefficients / 10.0 ** jnp.arange(5)
        way = eqx.tree_at(lambda w: w[0].coefficients, way, coefficients)
    found = sloped(*whole, way)
    for _, along, back in found:
        assert all(np.isfinite(x).all() for x in jax.tree.leaves((along, back)))
    # A step far below the distance from the axis, above the rounding of 100 px.
    for i, (step, rows) in enumerate(((1e-5, len(probes)), (1e-7, len(points)))):
        before, after = (sloped(*moved(whole, way, s), way)[i] for s in (-step, step))
        assert_slopes(found[i], before, after, (way[0], way[i + 1]), step, rows, **GRADIENT)


def test_all_values_of_a_lens_share_one_compilation():
    traced = eqx.debug.assert_max_traces(
        lambda lens, pixels: jax.vmap(lens.direction)(pixels), max_traces=1
    )
    compiled = jax.jit(traced)
    for k1 in (-0.02, -0.05, -0.08):
        compiled(fisheye((0.0, k1, 0.0, 0.0, 0.0), fov=3.0 - k1), pixel_centers())


@pytest.mark.parametrize(
    "build, message",
    [
        (lambda: fisheye((0.0, -0.08, 0.0, 0.0, 1e-5)), "lens.k must be monotone"),
        (lambda: fisheye((0.0, -0.05, 0.0, 0.0, jnp.nan)), "lens.k must be finite"),
        (lambda: fisheye((-3.0, -0.05, 0.0, 0.0, 0.0)), "lens.k must be monotone"),
        (lambda: fisheye((0.0, -0.05, 0.0, 0.0, 0.0), fov=0.0), "lens.fov must be above 0"),
        (
            lambda: fisheye((0.0, -0.05, 0.0, 0.0, 0.0), sensor=(36.0, -1.0)),
            "lens.sensor must be above 0",
        ),
        (lambda: pinhole(array(0.0, 1.0), CENTER), "lens.focal must be above 0"),
        (lambda: Pinhole(FOCAL, CENTER, BARREL, False), "lens.distortion must be 0 here"),
        (
            lambda: KannalaBrandt(FOCAL, CENTER, array(-0.4, 0.0, 0.0, 0.0), jnp.array(1.5)),
            "lens.k must be monotone",
        ),
        (
            lambda: KannalaBrandt(FOCAL, CENTER, array(0.0, 0.0, 0.0, 0.0), jnp.array(4.0)),
            "lens.max_angle must be in",
        ),
    ],
)
def test_what_is_no_lens_is_refused_by_name(build, message):
    with pytest.raises(ValueError, match=message):
        build()


def test_a_polynomial_may_turn_back_beyond_the_field_of_view():
    # theta = 0.12 r - 1e-5 r^4 has its top (1.3) at r = 14.4 mm, within the picture, and falls to
    # 0.99 in the corner (18.9 mm): with fov/2 = 0.45 nothing lit is ambiguous.
    k = (0.0, -0.12, 0.0, 0.0, 1e-5)
    assert fisheye(k, fov=0.9, sensor=(30.0, 20.0)).sees(array(48.0, 32.0))
    with pytest.raises(ValueError, match="lens.k"):
        fisheye(k, fov=3.0, sensor=(30.0, 20.0))


def test_check_lens_accepts_good_lenses_and_names_folded_ones():
    for name in ("pinhole", "barrel", "polynomial", "kannala"):
        check_lens(LENSES[name], WIDTH, HEIGHT)
    folded = Pinhole(FOCAL, CENTER, array(-0.8, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="lens.distortion must give every pixel"):
        check_lens(folded, WIDTH, HEIGHT)
    # Only where corners may stay dark is a lens good that has no ray there.
    lacking = check_lens(folded, WIDTH, HEIGHT, dark=0.9)
    corners = [jax.vmap(folded.direction)(array([0.5, 0.5], [WIDTH - 0.5, HEIGHT - 0.5]))]
    assert 0 < lacking < 0.9 and not np.any(corners)
    with pytest.raises(ValueError, match="lens.distortion must give every pixel"):
        check_lens(folded, WIDTH, HEIGHT, dark=0.9 * lacking)
    turned = eqx.tree_at(lambda x: x.coefficients, LENSES["mirrored"], array(0, -0.08, 0, 0, 1e-5))
    with pytest.raises(ValueError, match="lens.k must be monotone"):
        check_lens(turned, WIDTH, HEIGHT)


@pytest.mark.parametrize("count", [8, 12, 14])
def test_the_jacobian_of_the_distortion_is_its_derivative(count):
    k = jnp.asarray(
        [0.2, -0.05, 0.01, -0.02, 0.03, 0.1, 0.02, -0.01, 0.004, 0.003, -0.005, 0.002, 0.05, -0.08]
    )[:count]
    for xy in jnp.asarray([[0.0, 0.0], [0.4, -0.3], [-0.7, 0.9]]):
        np.testing.assert_allclose(
            np.reshape(distort_jacobian(k, xy), (2, 2)),
            jax.jacfwd(distort, argnums=1)(k, xy),
            rtol=1e-13,
            atol=1e-14,
        )
