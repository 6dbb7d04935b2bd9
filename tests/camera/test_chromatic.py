"""Lateral chromatic aberration: a size of the picture for each colour, about the axis."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy
from jax.test_util import check_grads

from gaussray.camera.camera import camera_rays, with_chromatic
from gaussray.camera.chromatic import reference_pixel
from gaussray.camera.lens import FisheyePolynomial, KannalaBrandt, pinhole
from gaussray.camera.principal_point import axis_of, require_axis


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


look = jax.jit(lambda lens, pixel, m: lens.direction(reference_pixel(lens, pixel, m)))
image = jax.jit(lambda lens, point: lens.project(point))


def blind():
    """A lens whose polynomial leaves out the axis."""
    k = jnp.array([-0.05, -0.06, 0.0, 0.0, 0.0])
    sensor = jnp.array([36.0, 36.0])
    return FisheyePolynomial(k, sensor, SIZE, jnp.zeros(2), jnp.array(3.0))


@pytest.mark.parametrize("name", LENSES)
def test_a_colour_sees_what_the_lens_images_nearer_to_the_axis_by_its_magnification(
    name,
):
    lens, m = LENSES[name], 1.01
    axis = axis_of(lens, jnp.float64)
    for rim in RIM:
        pixel = jnp.array(rim)
        back = image(lens, 3.7 * look(lens, pixel, m))
        # About half a pixel of fringe at 60 pixels from the axis.
        shift = pixel - back
        np.testing.assert_allclose(shift, (pixel - axis) * (1 - 1 / m), atol=EXACT)
        assert 0.3 < np.hypot(*shift) < 0.8


@pytest.mark.parametrize("name", LENSES)
def test_the_axis_and_magnification_one_change_nothing(name):
    lens = LENSES[name]
    axis = axis_of(lens, jnp.float64)
    np.testing.assert_allclose(look(lens, axis, 1.3), [0, 0, 1], atol=1e-7)
    same = reference_pixel(lens, jnp.array(RIM[1]), jnp.array(1.0))
    np.testing.assert_allclose(same, RIM[1], atol=EXACT)


def test_rays_without_a_colour_are_those_of_a_camera_without_aberration():
    camera = toy.camera()
    assert with_chromatic(camera, (1.0, 1.0, 1.0)).chromatic is None
    fringed = with_chromatic(camera, (1.01, 1.0, 0.99))
    assert fringed.lens is camera.lens
    pixel, u = toy.single([[3, 4]]), jnp.full((1, 5), 0.5, jnp.float32)
    plain, same = (camera_rays(x, pixel, u) for x in (camera, fringed))
    np.testing.assert_array_equal(same.direction, plain.direction)
    red = camera_rays(fringed, pixel, u, fringed.chromatic[0])
    green = camera_rays(fringed, pixel, u, fringed.chromatic[1])
    assert np.abs(red.direction - plain.direction).max() > 1e-4
    np.testing.assert_allclose(green.direction, plain.direction, atol=1e-6)
    np.testing.assert_array_equal(red.origin, plain.origin)


@pytest.mark.parametrize("name", LENSES)
def test_gradients(name):
    lens, pixel = LENSES[name], jnp.array(RIM[0])

    def direction(m, pixel):
        return lens.direction(reference_pixel(lens, jnp.asarray(pixel), jnp.asarray(m)))

    check_grads(direction, (jnp.array(1.02), pixel), 1, ("rev",), GRADIENT, GRADIENT)


def test_a_magnification_that_is_not_above_0_is_refused():
    for m in (0.0, -1.0, np.inf):
        with pytest.raises(ValueError, match="chromatic must be above 0"):
            with_chromatic(toy.camera(), (1.0, 1.0, m))


def test_an_axis_that_is_not_imaged_is_refused():
    for lens in LENSES.values():
        require_axis("sensor.chromatic", lens)
    with pytest.raises(ValueError, match="sensor.chromatic counts from the optical axis"):
        require_axis("sensor.chromatic", blind())
