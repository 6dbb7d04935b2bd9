"""The aperture: every sample meets the chief ray in focus; its shape and blur are Blender's."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from gaussray.camera.aperture import (
    Aperture,
    Rim,
    no_aperture,
    thin_lens,
    transmitted,
    with_edges,
)
from gaussray.geometry import normalize


# Lengths of order 1 in double precision.
EXACT = 1e-12
# Means of 128 x 128 stratified samples: error about 1/(count) of the cell size.
MEAN = 1e-3
GRADIENT = 1e-5


def aperture(radius=0.3, focus_distance=2.5, rotation=0.0, ratio=1.0, blades=0, focus="plane"):
    values = (jnp.array(float(v)) for v in (radius, focus_distance, rotation, ratio))
    return Aperture(*values, blades=blades, focus=focus)


def grid(side):
    """Middles of side x side cells of the unit square."""
    axis = (jnp.arange(side) + 0.5) / side
    return jnp.stack(jnp.meshgrid(axis, axis), -1).reshape(-1, 2)


def rim(count):
    """Points on the border of the unit square: the outline of the opening."""
    t = jnp.linspace(0, 1, count)
    zero, one = jnp.zeros(count), jnp.ones(count)
    sides = ((t, zero), (t, one), (zero, t), (one, t))
    return jnp.concatenate([jnp.stack(side, -1) for side in sides])


@jax.jit
def through(aperture, direction, u):
    return jax.vmap(thin_lens, in_axes=(None, None, 0))(aperture, direction, u)


SIDEWAYS = normalize(jnp.array([0.5, -0.3, 1.0]))
BACKWARDS = normalize(jnp.array([0.5, -0.3, -0.4]))


@pytest.mark.parametrize("blades", [0, 3, 7])
def test_a_number_of_blades_as_data_gives_the_same_rays(blades):
    fixed = aperture(blades=blades, rotation=0.4, ratio=1.3)
    for a, b in zip(
        through(fixed, SIDEWAYS, grid(9)),
        through(with_edges(fixed), SIDEWAYS, grid(9)),
        strict=True,
    ):
        np.testing.assert_allclose(a, b, atol=EXACT)


@pytest.mark.parametrize("blades", [0, 5])
def test_every_lens_sample_meets_the_chief_ray_on_the_plane_of_focus(blades):
    origin, direction = through(aperture(blades=blades), SIDEWAYS, grid(9))
    np.testing.assert_allclose(origin[:, 2], 0)
    at_focus = origin + direction * (2.5 / direction[:, 2:])
    expected = np.broadcast_to(SIDEWAYS * 2.5 / SIDEWAYS[2], at_focus.shape)
    np.testing.assert_allclose(at_focus, expected, atol=EXACT)
    np.testing.assert_allclose(np.linalg.norm(direction, axis=-1), 1, atol=EXACT)


@pytest.mark.parametrize("chief", [SIDEWAYS, BACKWARDS, jnp.array([0.0, 0.0, 1.0])])
def test_every_lens_sample_meets_the_chief_ray_on_the_sphere_of_focus(chief):
    origin, direction = through(aperture(focus="sphere"), chief, grid(9))
    np.testing.assert_allclose(origin @ chief, 0, atol=EXACT)  # perpendicular to the chief ray
    focus = 2.5 * chief[None] - origin
    along = np.sum(focus * direction, axis=-1, keepdims=True)
    np.testing.assert_allclose(along * direction, focus, atol=EXACT)
    distance = np.linalg.norm(through(aperture(focus="sphere"), chief, rim(5))[0], axis=-1)
    np.testing.assert_allclose(distance, 0.3, atol=EXACT)


def test_radius_zero_is_a_pinhole():
    for focus in ("plane", "sphere"):
        origin, direction = through(aperture(radius=0, focus=focus), SIDEWAYS, grid(3))
        np.testing.assert_array_equal(origin, np.zeros((9, 3)))
        np.testing.assert_allclose(direction, np.tile(SIDEWAYS, (9, 1)), atol=EXACT)
    np.testing.assert_array_equal(through(no_aperture(), SIDEWAYS, grid(2))[0], np.zeros((4, 3)))


@pytest.mark.parametrize("blades", [0, 3, 6])
def test_the_middle_sample_is_the_chief_ray(blades):
    half = jnp.array([0.5, 0.5])
    origin, direction = thin_lens(aperture(blades=blades, rotation=0.4), SIDEWAYS, half)
    np.testing.assert_array_equal(origin, [0, 0, 0])
    np.testing.assert_allclose(direction, SIDEWAYS, atol=EXACT)


def test_focus_at_infinity_sends_parallel_rays():
    for focus in ("plane", "sphere"):
        _, direction = through(aperture(focus_distance=np.inf, focus=focus), SIDEWAYS, grid(4))
        np.testing.assert_allclose(direction, np.tile(SIDEWAYS, (16, 1)), atol=EXACT)


def test_no_ray_stays_no_ray():
    for focus in ("plane", "sphere"):
        _, direction = thin_lens(aperture(focus=focus), jnp.zeros(3), jnp.array([0.9, 0.2]))
        np.testing.assert_array_equal(direction, [0, 0, 0])


def test_the_disc_is_uniform():
    origin, _ = through(aperture(radius=1), SIDEWAYS, grid(128))
    square = np.sum(origin**2, axis=-1)
    np.testing.assert_allclose(np.quantile(square, [0.25, 0.5, 0.75]), [0.25, 0.5, 0.75], atol=0.01)
    assert square.max() <= 1
    np.testing.assert_allclose(np.mean(origin, axis=0), 0, atol=MEAN)
    quarter = np.mean((origin[:, 0] > 0) & (origin[:, 1] > 0))
    np.testing.assert_allclose(quarter, 0.25, atol=MEAN)


@pytest.mark.parametrize("blades", [3, 4, 5, 8])
def test_the_polygon_is_uniform(blades):
    """Second moment of a regular polygon, and equal shares of two discs inside it."""
    origin, _ = through(aperture(radius=1, blades=blades, rotation=0.3), SIDEWAYS, grid(128))
    square = np.sum(origin**2, axis=-1)
    angle = 2 * np.pi / blades
    np.testing.assert_allclose(square.mean(), (2 + np.cos(angle)) / 6, atol=MEAN)
    np.testing.assert_allclose(np.mean(origin, axis=0), 0, atol=MEAN)
    area = blades / 2 * np.sin(angle)
    for r in (0.2, 0.45):  # within the inscribed circle of all of them (0.5)
        np.testing.assert_allclose(np.mean(square < r * r), np.pi * r * r / area, atol=5 * MEAN)


@pytest.mark.parametrize(
    "blades, rotation, measured",
    [(3, 0.0, 59.7), (5, 0.0, 35.8), (4, 0.0, 44.7), (6, 0.0, -29.9), (6, 0.3, -12.6)],
)
def test_vertices_are_where_blender_has_them(blades, rotation, measured):
    """Angles in degrees from +x towards up, as measured in Cycles to half a degree."""
    origin, _ = through(aperture(radius=1, blades=blades, rotation=rotation), SIDEWAYS, rim(4001))
    x, up = origin[:, 0], -origin[:, 1]
    distance = np.hypot(x, up)
    np.testing.assert_allclose(distance.max(), 1, atol=1e-6)
    np.testing.assert_allclose(distance.min(), np.cos(np.pi / blades), atol=1e-6)
    vertex = np.degrees(np.arctan2(up, x))[distance > 1 - 1e-4]
    period = 360 / blades
    away = (vertex - measured + period / 2) % period - period / 2
    assert np.abs(away).max() < 1.2  # 0.5 measured, 0.7 for points within 1e-4 of a vertex
    expected = np.degrees(rotation + np.pi / blades)
    away = (vertex - expected + period / 2) % period - period / 2
    np.testing.assert_allclose(np.mean(away), 0, atol=0.2)


@pytest.mark.parametrize("ratio, across", [(2.0, 0.5), (0.5, 2.0)])
def test_ratio_divides_the_width_of_the_aperture(ratio, across):
    origin, _ = through(aperture(radius=1, ratio=ratio), SIDEWAYS, rim(401))
    np.testing.assert_allclose(np.abs(origin).max(axis=0), [across, 1, 0], atol=1e-6)


@pytest.mark.parametrize("z", [1.0, 2.5, 6.0])
def test_the_circle_of_confusion_is_blenders(z):
    """Diameter f_px 2R |1/z - 1/focus| px at depth z, and 0 in focus."""
    f_px, radius, focus = 200.0, 0.3, 2.5
    origin, direction = through(aperture(), SIDEWAYS, rim(401))
    at_z = origin + direction * (z / direction[:, 2:])
    pixel = f_px * at_z[:, :2] / z
    diameter = pixel.max(axis=0) - pixel.min(axis=0)
    expected = f_px * 2 * radius * abs(1 / z - 1 / focus)
    np.testing.assert_allclose(diameter, [expected, expected], rtol=1e-4, atol=1e-10)


@jax.jit
def ray(lens, direction):
    return thin_lens(*jax.tree.map(jnp.asarray, (lens, direction)), jnp.array([0.8, 0.3]))


@pytest.mark.parametrize("focus", ["plane", "sphere"])
@pytest.mark.parametrize("blades", [0, 5])
@pytest.mark.parametrize("chief", [SIDEWAYS, jnp.array([0.0, 0.0, 1.0]), BACKWARDS])
def test_gradients_are_right_in_every_parameter(focus, blades, chief):
    lens = aperture(rotation=0.3, ratio=1.2, blades=blades, focus=focus)

    check_grads(ray, (lens, chief), order=1, modes=["rev"], rtol=GRADIENT)


@jax.jit
def gradients(lens, chiefs, corners):
    """The sum of each ray's origin, and the gradients of the sum of origin and direction."""

    def total(lens, chief, u):
        origin, direction = thin_lens(lens, chief, u)
        return jnp.sum(origin) + jnp.sum(direction), jnp.sum(origin)

    slopes = jax.grad(total, argnums=(0, 1, 2), has_aux=True)
    over_u = jax.vmap(slopes, in_axes=(None, None, 0))
    slope, origin = jax.vmap(over_u, in_axes=(None, 0, None))(lens, chiefs, corners)
    return origin, slope


@pytest.mark.parametrize("blades", [0, 5])
def test_gradients_at_the_extremes_are_those_of_one_scale_for_all_lengths(blades):
    """In other units origins are as many times as long, and directions the same: by Euler's
    theorem, radius and focus distance times their gradients add up to the origin."""
    corners = jnp.array([(0.0, 0.0), (1.0, 1.0), (0.0, 1.0), (0.5, 0.5), (0.5, 0.0), (0.75, 0.75)])
    chiefs = jnp.array([(0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0), (0.0, 0.0, 0.0)])
    for focus in ("plane", "sphere"):
        for radius in (0.0, 1e6):
            lens = aperture(radius=radius, blades=blades, focus=focus)
            origin, (slope, chief, u) = gradients(lens, chiefs, corners)
            lengths = radius * slope.radius, lens.focus_distance * slope.focus_distance
            np.testing.assert_allclose(sum(lengths), origin, atol=EXACT * max(radius, 1))
            if not radius:
                # A pinhole has no opening.
                for leaf in (u, slope.rotation, slope.ratio):
                    np.testing.assert_array_equal(leaf, 0)
            for leaf in jax.tree.leaves((slope, chief, u)):
                assert np.isfinite(leaf).all()


def test_single_precision_stays_single():
    lens, chief, u = jax.tree.map(
        lambda x: x.astype(jnp.float32), (aperture(blades=5), SIDEWAYS, grid(3))
    )
    assert all(x.dtype == jnp.float32 for x in through(lens, chief, u))


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"radius": -0.1}, "aperture.radius must be at least 0, got -0.1"),
        ({"radius": np.nan}, "aperture.radius must be at least 0, got nan"),
        ({"focus_distance": 0}, "aperture.focus_distance must be above 0, got 0"),
        ({"rotation": np.inf}, "aperture.rotation must be finite"),
        ({"ratio": 0}, "aperture.ratio must be above 0"),
        ({"blades": -1}, "aperture.blades must be a whole number from 0, got -1"),
        ({"blades": 1}, r"aperture.blades must be 0 \(round\) or at least 3 \(a polygon\), got 1"),
        ({"blades": 2}, r"aperture.blades must be 0 \(round\) or at least 3 \(a polygon\), got 2"),
        ({"focus": "cone"}, "aperture.focus must be one of"),
    ],
)
def test_what_is_no_aperture_is_refused_by_name(changes, message):
    with pytest.raises(ValueError, match=message):
        aperture(**changes)


def rimmed(rim_radius=0.25, rim_distance=0.4, **changes):
    rim = Rim(jnp.array(float(rim_radius)), jnp.array(float(rim_distance)))
    return dataclasses.replace(aperture(**changes), rim=rim)


@jax.jit
def weights(aperture, direction, u):
    return jax.vmap(transmitted, in_axes=(None, None, 0))(aperture, direction, u)


def overlap(r, s, d):
    """Area common to two discs of radii r and s, d apart."""
    a = (d * d + r * r - s * s) / (2 * d)
    b = d - a
    first = r * r * np.arccos(a / r) - a * np.sqrt(r * r - a * a)
    return first + s * s * np.arccos(b / s) - b * np.sqrt(s * s - b * b)


@pytest.mark.parametrize("rim_radius", [0.25, 0.35])
def test_the_share_that_a_rim_leaves_is_the_area_common_to_two_discs(rim_radius):
    """From the middle of the opening the rim looks 1/q as large and far, with q = 1 - L/f."""
    lens = rimmed(rim_radius)
    q = 1 - 0.4 / 2.5
    lean = 0.4 * np.hypot(0.5, 0.3)
    expected = overlap(0.3, rim_radius / q, lean / q) / (np.pi * 0.3**2)
    assert 0.2 < expected < 0.9
    found = np.mean(weights(lens, SIDEWAYS, grid(128)))
    np.testing.assert_allclose(found, expected, atol=MEAN)


@pytest.mark.parametrize("focus", ["plane", "sphere"])
@pytest.mark.parametrize("blades", [0, 5])
def test_samples_behind_a_rim_are_those_of_the_whole_opening_that_pass_it(blades, focus):
    """Brute force: mean of weight x light against that of rays through the whole opening, those
    that meet the plane of the rim outside of it being dark."""
    shape = {"blades": blades, "focus": focus, "rotation": 0.3, "ratio": 1.3}
    u, lens = grid(128), rimmed(0.22, 0.4, **shape)
    origin, direction = map(np.asarray, through(aperture(**shape), SIDEWAYS, u))
    facing = np.array([0.0, 0.0, 1.0]) if focus == "plane" else np.asarray(SIDEWAYS)
    middle = np.array([0.0, 0.0, 0.4])
    t = ((middle[None] - origin) @ facing) / (direction @ facing)
    at_rim = origin + t[:, None] * direction
    passes = np.linalg.norm(at_rim - middle[None], axis=1) < 0.22
    assert 0.1 < passes.mean() < 0.9

    def light(origin):
        return 1 + 3 * origin[:, 0] + origin[:, 1] + 20 * origin[:, 0] * origin[:, 1]

    weight = np.asarray(weights(lens, SIDEWAYS, u))
    inside, ahead = map(np.asarray, through(lens, SIDEWAYS, u))
    np.testing.assert_allclose(np.mean(weight), np.mean(passes), atol=3 * MEAN)
    np.testing.assert_allclose(
        np.mean(weight * light(inside)), np.mean(passes * light(origin)), atol=5 * MEAN
    )
    t = ((middle[None] - inside) @ facing) / (ahead @ facing)
    far = np.linalg.norm(inside + t[:, None] * ahead - middle[None], axis=1)
    assert far[weight > 0].max() < 0.22 + EXACT


def test_a_rim_wide_enough_changes_nothing():
    origin, direction = through(aperture(blades=6), SIDEWAYS, grid(9))
    same = through(rimmed(5.0, blades=6), SIDEWAYS, grid(9))
    np.testing.assert_allclose(same[0], origin, atol=EXACT)
    np.testing.assert_allclose(same[1], direction, atol=EXACT)
    np.testing.assert_array_equal(weights(rimmed(5.0), SIDEWAYS, grid(9)), 1)
    assert transmitted(aperture(), SIDEWAYS, jnp.array([0.3, 0.8])) is None


def test_nothing_passes_a_rim_from_the_side_or_far_off_the_axis():
    for chief in (BACKWARDS, jnp.array([1.0, 0.0, 0.0]), normalize(jnp.array([5.0, 0.0, 1.0]))):
        np.testing.assert_array_equal(weights(rimmed(), chief, grid(4)), 0)
    pinhole = rimmed(radius=0.0, rim_distance=0.3)
    np.testing.assert_array_equal(weights(pinhole, SIDEWAYS, grid(3)), 1)


def test_gradients_of_the_light_past_a_rim_are_right_and_those_of_its_area():
    """The samples move with the rim: the gradient of their mean weight is that of the area, which
    counting the rays that pass could not have."""
    lens, u = rimmed(0.25), grid(128)

    def seen(lens, chief):
        lens, chief = jax.tree.map(jnp.asarray, (lens, chief))
        origin, way = jax.vmap(thin_lens, in_axes=(None, None, 0))(lens, chief, u[::97])
        weight = jax.vmap(transmitted, in_axes=(None, None, 0))(lens, chief, u[::97])
        return jnp.mean(weight[:, None] * (origin + way), axis=0)

    check_grads(jax.jit(seen), (lens, SIDEWAYS), order=1, modes=["rev"], rtol=GRADIENT)

    def share(lens):
        return jnp.mean(jax.vmap(transmitted, in_axes=(None, None, 0))(lens, SIDEWAYS, u))

    found = jax.jit(jax.grad(share))(lens).rim.radius
    q, lean, h = 1 - 0.4 / 2.5, 0.4 * np.hypot(0.5, 0.3), 1e-6
    areas = [overlap(0.3, (0.25 + x) / q, lean / q) / (np.pi * 0.09) for x in (h, -h)]
    np.testing.assert_allclose(found, (areas[0] - areas[1]) / (2 * h), rtol=0.02)


@pytest.mark.parametrize(
    "build, message",
    [
        (lambda: rimmed(0.0), "aperture.rim.radius must be above 0"),
        (lambda: rimmed(rim_distance=3.0), "aperture.rim.distance must be below aperture.focus_"),
    ],
)
def test_what_is_no_rim_is_refused_by_name(build, message):
    with pytest.raises(ValueError, match=message):
        build()
