"""Sums of products are taken in full precision, whatever a device does by default."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.camera.camera import camera_rays
from gaussray.scene.scene import at
from gaussray.tracer.bundle import bound_bundles


# Directions are of length one: a few roundings of single precision.
ROUNDINGS = 4 * 2.0**-24
HIGHEST = (jax.lax.Precision.HIGHEST,) * 2


def products(jaxpr):
    """Precisions of all sums of products in a program and the programs in it."""
    for equation in jaxpr.eqns:
        if equation.primitive.name == "dot_general":
            yield equation.params["precision"]
        for value in jax.tree.leaves(list(equation.params.values()), is_leaf=is_program):
            if is_program(value):
                yield from products(getattr(value, "jaxpr", value))


def is_program(value):
    return hasattr(value, "eqns")


def look(camera):
    """Rays of a few pixels."""
    pixel = toy.single([[0, 0], [15, 3], [4, 15], [7, 8]])
    return camera_rays(camera, pixel, jnp.full((4, 5), 0.5, jnp.float32))


PROGRAMS = {
    "rays": lambda: jax.make_jaxpr(look)(toy.camera(0.3)),
    "scene": lambda: jax.make_jaxpr(at)(toy.scene(), toy.single(0.3)),
    "gradient": lambda: jax.make_jaxpr(
        jax.grad(lambda scene: jnp.sum(at(scene, toy.single(0.3)).mean))
    )(toy.scene()),
    "bounds": lambda: jax.make_jaxpr(lambda rays: bound_bundles(rays, toy.single([0])))(
        jax.tree.map(lambda x: x[None], look(toy.camera()))
    ),
}


@pytest.mark.parametrize("name", PROGRAMS)
def test_no_product_is_left_to_the_device(name):
    found = list(products(PROGRAMS[name]().jaxpr))
    assert found and set(found) == {HIGHEST}


@pytest.mark.gpu
def test_rays_on_the_device_are_those_of_double_precision():
    camera = toy.camera(0.3)
    with jax.enable_x64(True):
        double = jax.tree.map(lambda x: jnp.asarray(np.asarray(x), jnp.float64), camera)
        pixel = jnp.asarray([[0, 0], [15, 3], [4, 15], [7, 8]], jnp.float64)
        exact = camera_rays(double, pixel, jnp.full((4, 5), 0.5, jnp.float64))
    found = jax.jit(look)(camera)
    np.testing.assert_allclose(found.direction, exact.direction, atol=ROUNDINGS)
