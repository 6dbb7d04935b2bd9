"""Each colour has a picture of its own size, about the axis, under every lens."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy
from jax.test_util import check_grads

from gaussray.camera.camera import camera_rays
from gaussray.camera.chromatic import Chromatic, Magnified, achromatic, dispersed, magnified
from gaussray.camera.lens import FisheyePolynomial, KannalaBrandt, pinhole
from gaussray.camera.principal_point import axis_of, require_axis


pytestmark = pytest.mark.usefixtures("quick_compilation")

# Pixels, in double precision; the fisheyes' inverses are polished by Newton.
EXACT = 1e-9
GRADIENT = 1e-5
SIZE = jnp.array([128.0, 128.0])
CENTER = jnp.array([62.0, 65.5])
LENSES = {
    "pinhole": pinhole(jnp.array([90.0, 92.0]), CENTER),
    "distorted": pinhole(
        jnp.array([90.0, 92.0]), CENTER, jnp.array([-0.1, 0.01, 1e-3, -2e-3, 0, 0, 0, 0])
    ),
    "polynomial": FisheyePolynomial(
        jnp.array([0.0, -0.06, -1e-4, 0, 0]),
        jnp.array([36.0, 36.0]),
        SIZE,
        jnp.array([0.02, -0.01]),
        jnp.array(3.0),
    ),
    "kannala": KannalaBrandt(
        jnp.array([60.0, 61.0]), CENTER, jnp.array([0.01, 0, 0, 0]), jnp.array(1.5)
    ),
}
RIM = [(3.5, 64.0), (20.0, 110.0), (124.0, 60.5)]


look = jax.jit(lambda lens, pixel: lens.direction(pixel))
image = jax.jit(lambda lens, point: lens.project(point))


def blind():
    """A lens whose polynomial leaves out the axis."""
    k = jnp.array([-0.05, -0.06, 0.0, 0.0, 0.0])
    sensor = jnp.array([36.0, 36.0])
    return FisheyePolynomial(k, sensor, SIZE, jnp.zeros(2), jnp.array(3.0))


@pytest.mark.parametrize("name", LENSES)
def test_what_a_colour_sees_at_the_rim_the_lens_has_at_a_distance_smaller_by_its_size(name):
    lens, m = LENSES[name], 1.01
    axis = axis_of(lens, jnp.float64)
    for rim in RIM:
        pixel = jnp.array(rim)
        seen = look(Magnified(lens, jnp.array(m)), pixel)
        # By the lens's own projection: about half a pixel of fringe at 60 pixels from the axis.
        shift = pixel - image(lens, seen)
        np.testing.assert_allclose(shift, (pixel - axis) * (1 - 1 / m), atol=EXACT)
        assert 0.3 < np.hypot(*shift) < 0.8


@pytest.mark.parametrize("name", LENSES)
def test_projection_undoes_direction(name):
    lens = Magnified(LENSES[name], jnp.array(0.98))
    for rim in RIM:
        pixel = jnp.array(rim)
        back = image(lens, 3.7 * look(lens, pixel))
        np.testing.assert_allclose(back, pixel, atol=EXACT)


def test_the_axis_is_where_it_was():
    for lens in LENSES.values():
        axis = axis_of(lens, jnp.float64)
        seen = look(Magnified(lens, jnp.array(1.3)), axis)
        np.testing.assert_allclose(seen, [0, 0, 1], atol=1e-7)


def test_a_lens_of_all_colours_goes_by_magnification_one():
    lens = Chromatic(LENSES["kannala"], jnp.array([1.1, 1.0, 0.9]))
    pixel = jnp.array(RIM[1])
    direction = lens.lens.direction(pixel)
    np.testing.assert_array_equal(lens.direction(pixel), direction)
    np.testing.assert_array_equal(lens.project(direction), lens.lens.project(direction))


def test_no_dispersion_is_the_camera_itself_and_its_program():
    camera = toy.camera()
    assert dispersed(camera, (1.0, 1.0, 1.0)) is camera and achromatic(camera) is camera
    fringed = dispersed(camera, (1.01, 1.0, 0.99))
    assert achromatic(fringed).lens is camera.lens
    pixel, u = toy.single([[3, 4]]), jnp.full((1, 5), 0.5, jnp.float32)
    plain = str(jax.make_jaxpr(camera_rays)(camera, pixel, u))
    assert str(jax.make_jaxpr(camera_rays)(achromatic(fringed), pixel, u)) == plain
    red = magnified(fringed, fringed.lens.magnification[0])
    assert str(jax.make_jaxpr(camera_rays)(red, pixel, u)) != plain


@pytest.mark.parametrize("name", LENSES)
def test_gradients(name):
    lens, pixel = LENSES[name], jnp.array(RIM[0])

    def direction(m, pixel):
        return Magnified(lens, jnp.asarray(m)).direction(jnp.asarray(pixel))

    check_grads(direction, (jnp.array(1.02), pixel), 1, ("rev",), GRADIENT, GRADIENT)


def test_a_magnification_that_cannot_be():
    for m in (0.0, -1.0, np.inf):
        with pytest.raises(ValueError, match="lens.magnification must be above 0"):
            Magnified(LENSES["pinhole"], jnp.array(m))
    with pytest.raises(ValueError, match="lens.magnification must be above 0"):
        Chromatic(LENSES["pinhole"], jnp.array([1.0, 1.0, 0.0]))


def test_an_axis_that_is_not_imaged_is_refused():
    for lens in LENSES.values():
        require_axis("sensor.chromatic", lens)
    with pytest.raises(ValueError, match="sensor.chromatic counts from the optical axis"):
        require_axis("sensor.chromatic", blind())
