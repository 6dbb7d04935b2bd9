"""Arrays of a scene that do not fit one another are known by name, most without a trace."""

import re

import equinox as eqx
import jax.numpy as jnp
import pytest
import toy

from gaussray.scene import shape_check as of
from gaussray.scene.shape_check import shape_error


@pytest.fixture
def untraced(monkeypatch):
    """A trace fails the test."""
    monkeypatch.setattr(of, "_trace_error", lambda *_: pytest.fail("traced"))


@pytest.mark.parametrize("speed", [0.4, 0.0])
def test_arrays_that_fit_are_fine(speed):
    assert shape_error(toy.scene(speed=speed)) == ""


@pytest.mark.parametrize(
    ("where", "shape", "says"),
    [
        (lambda s: s.static.quat, (2, 3), "'static.quat' holds float32 of shape"),
        (lambda s: s.time_range, (3,), "'time_range' .* the axes '2'"),
        (lambda s: s.deformation.trunk.weight, (3,), "trunk.weight' .* axes 'inputs outputs'"),
        (lambda s: s.deformation.mean[1].bias, (3, 1), "'deformation.mean.1.bias'"),
        (lambda s: s.deformation.planes.space[0], (2, 4, 4, 4), "'deformation.planes.space.0'"),
        (lambda s: s.deformation.planes.begin, (1,), "'deformation.planes.begin' .* 'none'"),
        (lambda s: s.deformation.light, (9, 4), "'deformation.light'"),
    ],
)
def test_an_array_of_other_axes_is_named_without_a_trace(untraced, where, shape, says):
    scene = eqx.tree_at(where, toy.scene(), jnp.zeros(shape, jnp.float32))
    assert re.search(says, shape_error(scene))


def test_numbers_of_another_kind_are_named(untraced):
    scene = eqx.tree_at(lambda s: s.deformation.light, toy.scene(), jnp.zeros((9, 3), bool))
    assert "'deformation.light' holds bool" in shape_error(scene)


def test_arrays_that_fit_alone_and_not_together_are_found_by_a_trace():
    wide = jnp.zeros((3, 8), jnp.float32)
    scene = eqx.tree_at(lambda s: s.deformation.trunk.weight, toy.scene(), wide)
    assert shape_error(scene)
