"""A scene at a time: what stands still first, then what moves."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.scene import scene as dynamic
from gaussray.scene.scene import Scene


# One state computed alone and among others: float32 matrix products in another order.
CLOSE = {"rtol": 1e-5, "atol": 1e-6}

at, moving_at = jax.jit(dynamic.at), jax.jit(dynamic.moving_at)


def test_one_time_and_several_times_agree():
    scene, times = toy.scene(), toy.single([0.0, 0.3, 1.0])
    several, first = moving_at(scene, times), scene.static.count
    for key, time in enumerate(times):
        one = at(scene, time)
        for name in ("mean", "quat", "scale"):
            moved = getattr(one, name)[first:]
            np.testing.assert_allclose(getattr(several, name)[key], moved, **CLOSE)
        np.testing.assert_array_equal(several.opacity, one.opacity[first:])
        np.testing.assert_array_equal(several.harmonics, one.harmonics[first:])


def test_only_the_moving_gaussians_move():
    scene = toy.scene()
    first, last = (at(scene, toy.single(t)).mean for t in (0.0, 1.0))
    count = scene.static.count
    np.testing.assert_array_equal(first[:count], last[:count])
    assert (jnp.abs(first[count:] - last[count:]).max(axis=1) > 0.05).all()


def test_beyond_the_clip_the_scene_rests():
    scene = toy.scene()
    for inside, outside in ((0.0, -5.0), (1.0, 9.0)):
        near, far = (at(scene, toy.single(t)) for t in (inside, outside))
        for a, b in zip(jax.tree.leaves(near), jax.tree.leaves(far), strict=True):
            np.testing.assert_array_equal(a, b)


def test_a_scene_without_deformation_is_the_same_at_all_times():
    still = toy.scene(speed=0)
    assert still.deformation is None
    one = at(still, toy.single(0.7))
    assert one.count == still.static.count + still.moving.count
    np.testing.assert_array_equal(at(still, toy.single(0.0)).mean, one.mean)
    with pytest.raises(ValueError, match="no Gaussians that move"):
        dynamic.moving_at(still, toy.single([0.0, 1.0]))


def test_harmonics_of_unequal_degree_stand_side_by_side():
    still = toy.scene(speed=0)
    wide = toy.gaussians([[0, 0, 0]], 0.1, [[1, 1, 1]])
    padded = jnp.pad(wide.harmonics, ((0, 0), (0, 3), (0, 0)), constant_values=0.5)
    wide = type(wide)(wide.mean, wide.quat, wide.scale, wide.opacity, padded)
    both = at(Scene(still.static, wide, None, still.time_range), toy.single(0))
    assert both.harmonics.shape[1] == 4
    assert (both.harmonics[: still.static.count, 1:] == 0).all()
