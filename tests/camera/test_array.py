"""How finely the training cameras see a place, and what follows for the size of Gaussians."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import toy

from gaussray.camera.array import camera_set, pixel_spacing
from gaussray.reconstruct.optimize.optimizer import Parameters
from gaussray.reconstruct.optimize.scale_bounds import FLAT, scale_bounds, with_scale_bounds
from gaussray.scene.gaussians import unconstrain


# Chord and angle of a pixel of some dozens across: a few 1e-4.
CLOSE = 1e-3
FOCAL = 1.1 * toy.SIZE


def rig(*angles):
    """Cameras 3 away from the origin."""
    cameras = [toy.camera(angle) for angle in angles]
    stack = jax.tree.map(lambda *x: jnp.stack(x), *cameras)
    return camera_set(np.arange(len(cameras)), stack, extent=1.0)


def test_pixels_are_as_far_apart_as_the_nearest_camera_sees_them():
    place = toy.single([[0, 0, 0], [0, 0, -2], [0, 0, 2]])
    # From in front and from behind: at 3, 1 and 1 focal lengths' worth of pixels.
    both = pixel_spacing(rig(0.0, np.pi), place)
    np.testing.assert_allclose(both, np.array([3, 1, 1]) / FOCAL, rtol=CLOSE)
    front = pixel_spacing(rig(0.0), place)
    np.testing.assert_allclose(front, np.array([3, 1, 5]) / FOCAL, rtol=CLOSE)


def test_scales_end_at_the_footprint_and_discs_stay_flat():
    discs = toy.gaussians([[0, 0, 0]] * 3, 1.0, [0.5, 0.5, 0.5])
    least = 0.5 * 3 / FOCAL
    scale = toy.single([[1, 2, 3], [1e-6, 2, 1e-5], [least / 2] * 3])
    discs = unconstrain(type(discs)(discs.mean, discs.quat, scale, *list(vars(discs).values())[3:]))
    parameters = Parameters(discs, discs, None)
    found = with_scale_bounds(parameters, scale_bounds(parameters, rig(0.0), 0.5))
    thin = least * np.exp(-FLAT)
    expected = [[1, 2, 3], [thin, 2, least], [max(least / 2, thin)] * 3]
    for part in (found.static, found.moving):
        np.testing.assert_allclose(np.exp(part.log_scale), expected, rtol=CLOSE)


def test_without_a_footprint_nothing_is_too_small():
    discs = unconstrain(toy.gaussians([[0, 0, 0]], 1e-9, [0.5, 0.5, 0.5]))
    parameters = Parameters(discs, discs, None)
    found = with_scale_bounds(parameters, scale_bounds(parameters, rig(0.0), 0.0))
    assert eqx.tree_equal(found, parameters)


def test_no_scale_exceeds_the_distance_or_the_extent():
    # The camera is 3 away from the origin, the cameras' extent is 1.
    far, near = [0, 0, 0], [0, 0, -2.9]
    discs = unconstrain(toy.gaussians([far, near], 100.0, [0.5, 0.5, 0.5]))
    parameters = Parameters(discs, discs, None)
    found = with_scale_bounds(parameters, scale_bounds(parameters, rig(0.0), 0.5))
    np.testing.assert_allclose(np.exp(found.static.log_scale), [[3] * 3, [1] * 3], rtol=CLOSE)
