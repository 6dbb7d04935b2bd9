"""Plain numbers in, readable text out."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gaussray
from gaussray.capture.formats.paired import read_capture
from gaussray.io.plain_values import number, rows, to_array, to_device, vector
from gaussray.io.sample_data import sample


PINHOLE = gaussray.Pinhole(500, (320, 240))


def test_numbers_and_lists_become_arrays_and_arrays_stay():
    given = jnp.ones(3, jnp.float32)
    assert vector("x")(given) is given
    assert vector("x", 2, spread=True)(3).tolist() == [3, 3]
    assert rows("x", 3)([1, 2, 3]).shape == (1, 3)
    assert number("x")(np.int64(2)).dtype == jnp.result_type(float)
    assert number("x")(np.float32(2)).dtype == jnp.float32


def test_numbers_reach_the_device_as_they_are():
    given = np.arange(7.0, dtype=np.float32)
    placed = to_device(given)
    given[0] = 5
    assert isinstance(placed, jax.Array) and placed.tolist() == list(range(7))
    assert to_device([1, 2], jnp.float32).dtype == jnp.float32
    assert to_device(jnp.ones(2), jnp.float32).dtype == jnp.float32
    assert jax.jit(lambda x: x + to_device([1.0, 2.0], jnp.float32))(given[:2]).tolist() == [6, 3]


@pytest.mark.parametrize("value", ["wide", None, [1, 2], [[1], [2]], {}])
def test_what_is_no_number_is_refused_by_name(value):
    with pytest.raises(ValueError, match=r"aperture\.radius must be a number, got"):
        number("aperture.radius")(value)


def test_traced_numbers_in_a_list_keep_their_gradient():
    grad = jax.grad(lambda f: to_array("x", [f, 2 * f], "2 numbers", (2,)).sum())(3.0)
    assert grad == 3
    with pytest.raises(ValueError, match="x must be 3 numbers"):
        jax.grad(lambda f: vector("x", 3)([f, f]).sum())(3.0)


def test_a_camera_is_made_of_plain_numbers():
    camera = gaussray.Camera((640, 480), PINHOLE, gaussray.Aperture(0.1, 2), time=3)
    assert camera.film == gaussray.Film(640, 480)
    assert camera.aperture.ratio == 1 and camera.trajectory.quat.shape == (1, 4)
    assert not camera.lens.distorted
    assert gaussray.Pinhole(500, (320, 240), [-0.1, 0.01]).distortion.shape == (8,)


def test_a_repr_tells_what_differs_from_the_default():
    camera = gaussray.Camera((640, 480), PINHOLE, gaussray.Aperture(0.1, 2), time=3)
    assert repr(camera.aperture) == "Aperture(radius=0.1, focus_distance=2)"
    assert repr(camera.shutter) == "Shutter()"
    lines = repr(camera).splitlines()
    assert lines[1] == "  film=Film(width=640, height=480),"
    gaussians = gaussray.Gaussians.colored([[0, 0, 0], [1, 0, 0]], [1, 0, 0], scale=0.1)
    assert repr(gaussray.Scene(gaussians)) == "Scene(2 static Gaussians, times (0, 1))"
    many = gaussray.Rays(jnp.zeros((50, 3)), jnp.ones((50, 3)), jnp.zeros(50))
    assert "origin=float64[50, 3]" in repr(many)


def test_the_lens_of_a_camera_must_be_one():
    with pytest.raises((ValueError, TypeError), match="lens"):
        gaussray.Camera((4, 4), 50.0)  # type: ignore[arg-type]


def test_gaussians_of_one_colour_are_as_many_as_their_centres():
    mean = np.zeros((3, 3))
    made = gaussray.Gaussians.colored(mean, [1, 0.5, 0], scale=[0.1, 0.2, 0.3], opacity=[0.1] * 3)
    assert made.scale.shape == (3, 3) and made.quat.shape == (3, 4)
    with pytest.raises(ValueError, match="gaussians.opacity must be one for all or one for each"):
        gaussray.Gaussians.colored(mean, [1, 0.5, 0], opacity=[0.1, 0.2])


def test_a_tree_of_shapes_can_be_printed():
    """Such trees have the types of what they describe, and debuggers print them."""
    scene = gaussray.load("sample")
    for tree in (scene, scene.static, read_capture(sample("capture")).views[0].camera):
        assert repr(jax.tree.map(jnp.shape, tree)).startswith(f"{type(tree).__name__}(")
        assert repr(jax.tree.map(lambda x: None, tree)).startswith(f"{type(tree).__name__}(")
