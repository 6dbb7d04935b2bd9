"""Scenes in changing light: their Gaussians at a time, on disk and in other programs."""

from dataclasses import replace

import jax
import numpy as np
import pytest
import toy

from gaussray.scene.array_file import read_arrays, write_arrays
from gaussray.scene.formats.convert import gaussians_at
from gaussray.scene.formats.export_transients import export_transients
from gaussray.scene.gaussians import fold_tint
from gaussray.scene.harmonics import C0
from gaussray.scene.light import Light
from gaussray.scene.scene import at
from gaussray.scene.store import load_scene, save_scene


# Rounding of single precision.
ROUNDING = 1e-5


def lamp(*gain):
    return Light(toy.single([0.0, 1.0]), toy.single(gain))


def lit(**changes):
    """What stands still, what moves and what is there for a short time, in two colours of light."""
    light = lamp([1.0, 1.0, 1.0], [3.0, 0.5, 1.0])
    return replace(toy.scene(), transient=toy.transients(), light=light, **changes)


def test_light_is_linear_between_its_times_and_constant_beyond():
    light = lamp([1.0, 2.0, 0.5], [3.0, 1.0, 0.5])
    found = light.at(toy.single([-1.0, 0.0, 0.25, 1.0, 7.0]))
    expected = [[1, 2, 0.5], [1, 2, 0.5], [1.5, 1.75, 0.5], [3, 1, 0.5], [3, 1, 0.5]]
    np.testing.assert_allclose(found, expected, rtol=ROUNDING)


def test_gaussians_at_a_time_have_the_colours_of_its_light():
    scene, time = lit(), toy.single(0.5)
    usual, shown = fold_tint(at(replace(scene, light=None), time)), at(scene, time)
    expected = np.array([2.0, 0.75, 1.0]) * np.asarray(usual.harmonics[:, 0] * C0 + 0.5)
    np.testing.assert_allclose(shown.harmonics[:, 0] * C0 + 0.5, expected, atol=ROUNDING)
    np.testing.assert_array_equal(shown.mean, usual.mean)
    np.testing.assert_array_equal(shown.opacity, usual.opacity)


@pytest.mark.parametrize("precision", ["full", "compact"])
def test_light_is_stored_exactly_in_version_7(tmp_path, precision):
    scene = lit()
    save_scene(tmp_path / "scene.npz", scene, precision=precision)
    assert read_arrays(tmp_path / "scene.npz", "gaussray-scene", 7)[0]["version"] == 7
    loaded = load_scene(tmp_path / "scene.npz")
    np.testing.assert_array_equal(loaded.light.time, scene.light.time)
    np.testing.assert_array_equal(loaded.light.gain, scene.light.gain)
    assert loaded.transient.count == scene.transient.count


@pytest.mark.parametrize(
    "change",
    [
        {"light.time": np.float32([1, 0])},
        {"light.gain": np.float32([[1, 1, 1], [0, 1, 1]])},
        {"light.gain": np.ones((3, 3), np.float32)},
    ],
)
def test_damaged_light_is_refused(tmp_path, change):
    save_scene(tmp_path / "scene.npz", lit())
    header, array = read_arrays(tmp_path / "scene.npz", "gaussray-scene", 7)
    write_arrays(tmp_path / "scene.npz", header, array | change)
    with pytest.raises(ValueError, match=r"light\.time' must increase and 'light\.gain'"):
        load_scene(tmp_path / "scene.npz")


def test_exports_ask_for_a_time_or_say_that_light_is_left_out(tmp_path):
    light = lamp([1.0, 1.0, 1.0], [2.0, 2.0, 2.0])
    still = replace(toy.scene(), light=light, deformation=None)
    still = replace(still, moving=jax.tree.map(lambda x: x[:0], still.moving))
    with pytest.raises(ValueError, match="time must be given for a scene that changes"):
        gaussians_at(still, time=None, color="linear", degree=0)
    bright, _ = gaussians_at(still, time=1.0, color="linear", degree=0)
    usual, _ = gaussians_at(still, time=0.0, color="linear", degree=0)
    twice = 2 * (usual.harmonics[:, 0] * C0 + 0.5)
    np.testing.assert_allclose(bright.harmonics[:, 0] * C0 + 0.5, twice, atol=ROUNDING)
    said = export_transients(still, tmp_path / "a.ply", color="linear", degree=0)
    assert said.endswith("the change of light over time is left out.")
