"""Shading of static Gaussians: the factor at places and times, pictures, files and exports."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy
from jax.test_util import check_grads

from gaussray.render.options import RenderOptions
from gaussray.render.renderer import Renderer
from gaussray.scene.array_file import read_arrays, write_arrays
from gaussray.scene.formats.convert import gaussians_at
from gaussray.scene.formats.export_transients import export_transients
from gaussray.scene.gaussians import fold_tint
from gaussray.scene.harmonics import C0
from gaussray.scene.scene import Scene, at, static_at
from gaussray.scene.shading import Shading
from gaussray.scene.store import load_scene, save_scene


# Double precision: the same sums in another order. Single precision: its rounding.
EXACT, ROUNDING = 1e-12, 1e-5
# Central differences with steps of 1e-4, in double precision.
DIFFERENCES = 1e-6
# Half of a step of 1/256, at which compact files keep logarithms.
HALF_STEP = 0.5 / 256
LOWER, UPPER, TIMES = np.array([-2.0, 0.0, 1.0]), np.array([2.0, 1.0, 4.0]), np.array([0.0, 1, 3])
SHAPE = 5, 2, 4


def shading(log_gain, dtype=np.float64):
    return Shading(*(jnp.asarray(x, dtype) for x in (LOWER, UPPER, TIMES, log_gain)))


def places(count=40, seed=0):
    return np.random.default_rng(seed).uniform(LOWER, UPPER, (count, 3))


def random_gains(seed=1):
    return np.random.default_rng(seed).normal(size=(len(TIMES), *SHAPE))


def over_the_wall(gain=(1.0, 0.25)):
    """A shade over all of the toy scene, of two factors at its first and its last time."""
    log_gain = np.log(gain).reshape(2, 1, 1, 1) * np.ones((2, 2, 2, 2))
    parts = (np.full(3, -4.0), np.full(3, 4.0), np.array([0.0, 1.0]), log_gain)
    return Shading(*(toy.single(x) for x in parts))


def test_logarithms_that_are_linear_in_place_and_time_are_met_exactly():
    x, y, z = np.meshgrid(
        *(np.linspace(*ends, n) for *ends, n in zip(LOWER, UPPER, SHAPE, strict=True)),
        indexing="ij",
    )
    at_rest = 0.1 * x - 0.3 * y + 0.05 * z
    found = shading(TIMES[:, None, None, None] * at_rest)
    place = places()
    for time in (0.0, 0.4, 1.0, 2.2, 3.0):
        slope = place @ [0.1, -0.3, 0.05]
        gain = found.at(jnp.asarray(place), jnp.asarray(time))
        np.testing.assert_allclose(gain, np.exp(time * slope), rtol=EXACT)


def test_factors_are_the_weighted_means_of_eight_vertices_and_two_times():
    log_gain, place, time = random_gains(), places(), 1.7
    grid = (place - LOWER) / (UPPER - LOWER) * (np.array(SHAPE) - 1)
    expected = np.zeros(len(place))
    for row, share in ((1, (3 - time) / 2), (2, (time - 1) / 2)):
        for vertex in np.ndindex(SHAPE):
            weight = np.prod(np.maximum(1 - np.abs(grid - vertex), 0), axis=1)
            expected += share * weight * log_gain[(row, *vertex)]
    found = shading(log_gain).at(jnp.asarray(place), jnp.asarray(time))
    np.testing.assert_allclose(found, np.exp(expected), rtol=EXACT)


def test_it_falls_to_1_beyond_the_grid_and_is_constant_before_and_after_its_times():
    some, now = shading(random_gains()), jnp.asarray(1.0)
    edge = places() * [0, 1, 1] + [2, 0, 0]
    logs = [np.log(some.at(jnp.asarray(edge + [x, 0, 0]), now)) for x in (0, 0.25, 1, 5)]
    np.testing.assert_allclose(logs[1], 0.75 * logs[0], rtol=1e3 * EXACT)
    np.testing.assert_array_equal(logs[2:], np.zeros((2, len(edge))))
    inside = jnp.asarray(places())
    for outer, end in ((-5.0, 0.0), (9.0, 3.0)):
        early, known = (some.at(inside, jnp.asarray(t)) for t in (outer, end))
        np.testing.assert_allclose(early, known, rtol=EXACT)


def test_a_single_time_serves_all():
    one = Shading(*(jnp.asarray(x) for x in (LOWER, UPPER, TIMES[:1], random_gains()[:1])))
    first, last = (one.at(jnp.asarray(places()), jnp.asarray(t)) for t in (-1.0, 5.0))
    np.testing.assert_array_equal(first, last)


def test_gradients_agree_with_differences():
    def total(log_gain, place):
        return jnp.sum(shading(log_gain).at(jnp.asarray(place), jnp.asarray(0.3)))

    check_grads(total, (random_gains(), places(6)), 1, modes=["rev"], rtol=DIFFERENCES)


def test_held_places_get_no_gradient():
    some, static = shading(random_gains()), jax.tree.map(jnp.float64, toy.scene().static)

    def total(mean, held):
        moved = replace(static, mean=mean)
        return jnp.sum(some.applied_to(moved, jnp.asarray(0.3), held=held).harmonics)

    inside = jnp.asarray(places(static.count))
    assert not np.any(jax.grad(total)(inside, True)) and np.any(jax.grad(total)(inside, False))


def test_only_static_gaussians_are_shaded():
    plain = replace(toy.scene(), transient=toy.transients())
    shown = replace(plain, shading=over_the_wall())
    time, still = toy.single(0.5), plain.static.count
    before, after = (fold_tint(at(x, time)) for x in (plain, shown))
    factor = np.ones(before.count)
    factor[:still] = 0.5
    color = (np.asarray(x.harmonics[:, 0] * C0 + 0.5) for x in (before, after))
    usual, shaded = color
    np.testing.assert_allclose(shaded, factor[:, None] * usual, atol=ROUNDING)
    for name in ("mean", "quat", "scale", "opacity"):
        np.testing.assert_array_equal(getattr(before, name), getattr(after, name))


@pytest.mark.parametrize("moves", [True, False])
def test_pictures_show_the_shade_of_the_middle_of_their_times(moves):
    one = toy.scene(speed=1.0 if moves else 0)
    shown = replace(one, shading=over_the_wall())
    camera = toy.rolling(toy.camera(time=0.5), readout=0.4)
    options = RenderOptions(samples=1)
    folded = replace(shown, static=static_at(shown, toy.single(0.5)), shading=None)
    found, expected = (
        Renderer(x, options=options, trace=toy.TRACE)(camera).color for x in (shown, folded)
    )
    np.testing.assert_allclose(found, expected, atol=ROUNDING)
    dark = Renderer(one, options=options, trace=toy.TRACE)(camera).color
    assert np.all(found <= dark + ROUNDING)
    np.testing.assert_allclose(found[:2, :2], 0.5 * dark[:2, :2], atol=ROUNDING)


@pytest.mark.parametrize(("precision", "off"), [("full", 0.0), ("compact", HALF_STEP)])
def test_it_is_stored_in_version_8(tmp_path, precision, off):
    scene = replace(toy.scene(), shading=over_the_wall((1.0, 0.3)))
    save_scene(tmp_path / "scene.npz", scene, precision=precision)
    assert read_arrays(tmp_path / "scene.npz", "gaussray-scene", 8)[0]["version"] == 8
    loaded = load_scene(tmp_path / "scene.npz")
    assert isinstance(loaded, Scene)
    for name in ("lower", "upper", "time"):
        np.testing.assert_array_equal(getattr(loaded.shading, name), getattr(scene.shading, name))
    gain = loaded.shading.log_gain
    np.testing.assert_allclose(gain, scene.shading.log_gain, atol=off, rtol=0)


@pytest.mark.parametrize(
    "change",
    [
        {"shading.time": np.float32([1, 0])},
        {"shading.upper": np.float32([-5, -5, -5])},
        {"shading.lower": np.float32([0, 0])},
        {"shading.log_gain": np.zeros((3, 2, 2, 2), np.float32)},
        {"shading.log_gain": np.zeros((2, 2, 2), np.float32)},
        {"shading.log_gain": np.zeros((2, 2, 1, 2), np.float32)},
    ],
)
def test_a_damaged_one_is_refused(tmp_path, change):
    save_scene(tmp_path / "scene.npz", replace(toy.scene(), shading=over_the_wall()))
    header, array = read_arrays(tmp_path / "scene.npz", "gaussray-scene", 8)
    write_arrays(tmp_path / "scene.npz", header, array | change)
    with pytest.raises(ValueError, match="'shading' must hold a box"):
        load_scene(tmp_path / "scene.npz")


def test_exports_ask_for_a_time_or_say_that_it_is_left_out(tmp_path):
    still = replace(toy.scene(speed=0), shading=over_the_wall())
    still = replace(still, moving=jax.tree.map(lambda x: x[:0], still.moving))
    with pytest.raises(ValueError, match="time must be given for a scene that changes"):
        gaussians_at(still, time=None, color="linear", degree=0)
    dark, _ = gaussians_at(still, time=1.0, color="linear", degree=0)
    usual, _ = gaussians_at(still, time=0.0, color="linear", degree=0)
    quarter = 0.25 * (usual.harmonics[:, 0] * C0 + 0.5)
    np.testing.assert_allclose(dark.harmonics[:, 0] * C0 + 0.5, quarter, atol=ROUNDING)
    said = export_transients(still, tmp_path / "a.ply", color="linear", degree=0)
    assert said.endswith("shadows that pass are left out.")
