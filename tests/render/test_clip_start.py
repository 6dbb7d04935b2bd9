"""What is nearer than `clip_start` is not seen, and all else is as it was."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import plates
import pytest
import toy

import gaussray
from gaussray.camera.camera import camera_rays
from gaussray.camera.rays import moved_to_start
from gaussray.render.aov.labeller import Labeller
from gaussray.render.options import RenderOptions
from gaussray.render.renderer import Renderer
from gaussray.scene.gaussians import concatenate
from gaussray.scene.scene import Scene


# Single precision, of pictures whose lists are in another order.
ROUNDING = 2e-5
NEAR, FAR = 0.5, 3.0
OPTIONS = RenderOptions(samples=2)


def still(*matter) -> Scene:
    gaussians = matter[0] if len(matter) == 1 else concatenate(*matter)
    gaussians = jax.tree.map(lambda x: x.astype(jnp.float32), gaussians)
    none = jax.tree.map(lambda x: x[:0], gaussians)
    return Scene(gaussians, none, None, toy.single([0, 1]))


def clipped(camera, start):
    return dataclasses.replace(camera, clip_start=toy.single(start))


@pytest.fixture(scope="module")
def scenes():
    """A plate far away, and the same behind one that is so near that it hides all of it."""
    far = plates.plate(2.6, z=FAR)
    near = plates.plate(0.4, z=NEAR, spacing=0.1)
    return still(far), still(far, near)


@pytest.mark.parametrize("backend", ["auto", "array"])
def test_a_camera_sees_what_is_behind_a_body_around_it(scenes, backend):
    alone, hidden = scenes
    camera = plates.camera(0.0)
    trace = dataclasses.replace(toy.TRACE, backend=backend)
    expected = Renderer(alone, options=OPTIONS, trace=trace)(camera)
    render = Renderer(hidden, options=OPTIONS, trace=trace)
    blocked, seen = render(camera), render(clipped(camera, 0.8))
    middle = blocked.depth[8:16, 8:16]
    assert np.all(middle < NEAR + 0.1)
    for name in ("color", "alpha", "depth"):
        np.testing.assert_allclose(getattr(seen, name), getattr(expected, name), atol=ROUNDING)


def test_a_picture_as_a_pure_function_is_the_same(scenes):
    alone, hidden = scenes
    camera = plates.camera(0.0)
    expected = gaussray.render(alone, camera, options=OPTIONS)
    seen = gaussray.render(hidden, clipped(camera, 0.8), options=OPTIONS)
    np.testing.assert_allclose(seen.color, expected.color, atol=ROUNDING)
    np.testing.assert_allclose(seen.depth, expected.depth, atol=ROUNDING)


def test_labels_are_of_what_is_seen_and_distances_from_the_lens(scenes):
    alone, hidden = scenes
    names = ["depth", "z", "gaussian", "origin"]
    trace = dataclasses.replace(toy.TRACE, backend="array")
    options = RenderOptions(samples=1)
    camera = plates.camera(0.0)
    expected = Labeller(alone, options=options, trace=trace)(camera, names)
    seen = Labeller(hidden, options=options, trace=trace)(clipped(camera, 0.8), names)
    np.testing.assert_array_equal(seen["gaussian"], expected["gaussian"])
    for name in ("depth", "z", "origin"):
        np.testing.assert_allclose(seen[name], expected[name], atol=ROUNDING)


def test_rays_begin_later_on_the_same_lines():
    pixel, u = jnp.array([[3.0, 5.0], [20.0, 2.0]]), jnp.full((2, 5), 0.3)
    camera = jax.tree.map(lambda x: x.astype(float), plates.camera(0.0))
    plain = jax.jit(camera_rays)(camera, pixel, u)
    later = jax.jit(camera_rays)(dataclasses.replace(camera, clip_start=jnp.array(0.7)), pixel, u)
    np.testing.assert_array_equal(later.origin, plain.origin)
    np.testing.assert_array_equal(later.direction, plain.direction)
    moved = moved_to_start(later)
    assert moved.start is None and moved_to_start(plain) is plain
    np.testing.assert_allclose(moved.origin, plain.origin + 0.7 * plain.direction, rtol=1e-15)


def test_where_nothing_is_near_neither_picture_nor_derivative_depends_on_it():
    camera = toy.camera()
    scene = toy.scene()
    plan = gaussray.plan(scene, clipped(camera, 0.0), options=OPTIONS)

    def total(start):
        seen = gaussray.render(scene, clipped(camera, start), plan=plan)
        return jnp.sum(seen.color) + jnp.sum(seen.depth * seen.alpha)

    value, slope = jax.jit(jax.value_and_grad(total))(toy.single(0.2))
    np.testing.assert_allclose(value, jax.jit(total)(toy.single(0.0)), rtol=ROUNDING)
    # Of some hundred pixels: the sum of their rounding.
    np.testing.assert_allclose(slope, 0, atol=1e-3)


@pytest.mark.parametrize("wrong", [-0.1, float("nan"), float("inf")])
def test_a_wrong_start_is_refused(wrong):
    with pytest.raises(ValueError, match="clip_start must be at least 0"):
        dataclasses.replace(toy.camera(), clip_start=wrong)
