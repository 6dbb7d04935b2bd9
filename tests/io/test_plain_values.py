"""Plain numbers in, readable text out."""

import subprocess
import sys

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


# In a process of its own: here the type checker of the tests would answer first.
WRONG_ARGUMENTS = """
import gaussray as g
film, lens = (4, 3), g.Pinhole(9, (2, 1.5))
camera, scene = g.Camera(film, lens), g.Scene(g.Gaussians.colored([0, 0, 4], [1, 0, 0]))
for call in (
    lambda: g.Camera(film, 90),
    lambda: g.Camera(96, lens),
    lambda: g.Camera(film, lens, aperture=0.1),
    lambda: g.Camera(film, lens, shutter=0.1),
    lambda: g.Camera(film, lens, trajectory=[0, 0, 1]),
    lambda: g.RenderOptions(samples=1.5),
    lambda: g.Scene(3),
    lambda: g.render(3, camera),
    lambda: g.render(scene, 3),
    lambda: g.render(scene, camera, options=3),
    lambda: g.render_rays(scene, camera),
    lambda: g.plan(scene, 3),
    lambda: g.Renderer(3),
    lambda: g.save(scene, "a.npz"),
    lambda: g.save("a.npz", camera),
):
    try:
        call()
    except ValueError as error:
        print(error)
"""
EXPECTED = """\
camera.lens must be a lens, such as gaussray.Pinhole, got 90.
camera.film must be (width, height) or a gaussray.Film, got 96.
camera.aperture must be a gaussray.Aperture, got 0.1.
camera.shutter must be a gaussray.Shutter, such as gaussray.rolling_shutter(readout, rows), got 0.1.
camera.trajectory must be a gaussray.Trajectory, such as gaussray.look_at(eye), got [0, 0, 1].
render.samples must be a whole number, got 1.5.
scene.static must be gaussray.Gaussians, got 3.
scene must be a gaussray.Scene or Clip, such as gaussray.load(path), got 3.
camera must be a gaussray.Camera, got 3.
options must be gaussray.RenderOptions(...), got 3.
rays must be gaussray.Rays, got Camera(
camera must be a gaussray.Camera or gaussray.Rays, got 3.
scene must be a gaussray.Scene or Clip, such as gaussray.load(path), got 3.
save(path, scene): path must be the name of a file, got Scene(1 static Gaussians, times (0, 1)).
save(path, scene): scene must be a gaussray.Scene or Clip, such as gaussray.load(path), got Camera(
"""


def test_another_object_in_the_place_of_an_argument_is_refused_by_its_name():
    command = [sys.executable, "-c", WRONG_ARGUMENTS]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    first_lines = [line for line in done.stdout.splitlines() if " must be " in line]
    assert first_lines == EXPECTED.splitlines()


def test_whole_numbers_may_be_those_of_numpy():
    assert gaussray.Film(*np.array([4, 3])) == gaussray.Film(4, 3)
    assert gaussray.RenderOptions(samples=np.int64(2)) == gaussray.RenderOptions(samples=2)
    with pytest.raises(ValueError, match="rows must be a whole number from 1, got 0"):
        gaussray.rolling_shutter(1.0, rows=0)


def test_scales_are_above_zero_and_opacities_from_zero_to_one():
    with pytest.raises(ValueError, match="gaussians.scale must be above 0, got"):
        gaussray.Gaussians.colored([0, 0, 1], [1, 0, 0], scale=-1)
    points = np.zeros((9, 3))
    with pytest.raises(ValueError, match="opacity must be from 0 to 1, got 2 among 20 numbers"):
        gaussray.Gaussians.colored(np.zeros((20, 3)), [1, 0, 0], opacity=2)
    assert gaussray.Gaussians.colored(points, [1, 0, 0], scale=(1, 2, 3)).count == 9


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


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: gaussray.KannalaBrandt(9, (5, 5), np.zeros(3), 1.2), r"lens\.k must be 4 numbers"),
        (lambda: gaussray.KannalaBrandt(9, (5, 5), jnp.zeros(5), 1.2), r"lens\.k must be 4"),
        (lambda: gaussray.Pinhole(np.ones(3), (5, 5)), r"lens\.focal must be 2 numbers"),
        (lambda: gaussray.Pinhole(9, np.ones(3)), r"lens\.center must be 2 numbers"),
        (lambda: gaussray.look_at(np.array([0.0, 4])), r"camera\.eye must be 3 numbers"),
        (
            lambda: gaussray.Gaussians.colored(np.zeros((2, 2)), [1, 0, 0]),
            r"of shape \(2, 2\)",
        ),
    ],
)
def test_an_array_of_another_length_is_refused(make, says):
    with pytest.raises(ValueError, match=says):
        make()


def test_arrays_may_be_stacked():
    stacked = gaussray.Pinhole(np.ones((7, 2)), np.ones((7, 2)))
    assert stacked.focal.shape == (7, 2)
