"""The numbers of a camera: what they are called, what they do, what is told of them."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.calibrate.parameters import (
    KINDS,
    corrected_camera,
    prepare_lens,
    reported_values,
    unit_camera_set,
    unknowns,
)
from gaussray.camera.lens import FisheyePolynomial, KannalaBrandt, pinhole
from gaussray.geometry import multiply, rotation_matrix, turning


# Single precision of values up to 20.
SAME = 1e-5
MIDDLE = toy.single([8.0, 8.0])
FISHEYE = KannalaBrandt(MIDDLE, MIDDLE, toy.single([0.05, 0, -0.01, 0]), toy.single(1.2))
POLYNOMIAL = FisheyePolynomial(
    toy.single([0, -0.07, 1e-4, -2e-5, 0]), toy.single([36, 36]), toy.single([16, 16]),
    toy.single([0.0, 0.0]), toy.single(3.0),
)  # fmt: skip


def names(lens, named=()):
    return [one.name for one in unknowns(("lens",), lens, named)][2:]


def changed(lens, **wrong):
    """A camera with this lens whose named unknowns are wrong by so much, what was told, gains."""
    camera = dataclasses.replace(toy.rolling(toy.camera(0.3, 0.5)), lens=lens)
    told, unit = unknowns(KINDS, lens), unit_camera_set(camera)
    value = toy.single([wrong.get(one.name.replace(".", "_"), 0.0) for one in told])
    after, gain = jax.jit(lambda v: corrected_camera(v, camera, unit, told))(value)
    read = jax.jit(lambda v: reported_values(v, camera, unit, told))(value)
    return camera, after, dict(zip((one.name for one in told), np.asarray(read), strict=True)), gain


def test_coefficients_are_those_that_bend_or_are_named():
    assert names(FISHEYE) == ["k1", "k3"]
    assert names(FISHEYE, ("k2",)) == ["k2"]
    # A polynomial's linear coefficient is its focal length.
    assert names(POLYNOMIAL) == ["k2", "k3"]
    ideal = pinhole(MIDDLE, MIDDLE)
    assert names(ideal) == []
    ready = prepare_lens(ideal, ("k1", "s2"))
    assert ready.distortion.shape == (12,) and ready.distorted
    assert names(ready, ("k1", "s2")) == ["k1", "s2"]


def test_a_coefficient_that_a_lens_has_not_is_refused():
    with pytest.raises(ValueError, match="calibrate.coefficients must be among k1, k2, k3, k4"):
        prepare_lens(FISHEYE, ("p1",))


def test_zeros_are_the_camera_as_recorded():
    camera, after, _, gain = changed(FISHEYE)
    for a, b in zip(jax.tree.leaves(camera), jax.tree.leaves(after), strict=True):
        np.testing.assert_allclose(a, b, atol=SAME)
    np.testing.assert_array_equal(gain, 1)


def test_a_pose_turns_and_moves_along_the_cameras_own_axes():
    camera, after, read, _ = changed(FISHEYE, turn_down=0.1, shift_forward=0.5)
    forward = rotation_matrix(camera.trajectory.quat[0])[:, 2]
    moved = after.trajectory.translation - camera.trajectory.translation
    np.testing.assert_allclose(moved[0], 0.5 * forward, atol=SAME)
    own = multiply(camera.trajectory.quat[0], turning(toy.single([0, 0.1, 0])))
    np.testing.assert_allclose(
        rotation_matrix(after.trajectory.quat[0]), rotation_matrix(own), atol=SAME
    )
    np.testing.assert_allclose(read["turn.down"], np.degrees(0.1), rtol=SAME)


def test_what_is_told_is_what_a_list_would_hold():
    camera, after, read, gain = changed(
        FISHEYE, focal=0.1, center_x=0.25, k3=0.02, readout=0.2, gain_blue=-0.1, offset=0.03
    )
    np.testing.assert_allclose(after.lens.focal, np.exp(0.1) * MIDDLE, rtol=SAME)
    np.testing.assert_allclose([read["focal"], read["center.x"]], [after.lens.focal[0], 10], SAME)
    np.testing.assert_allclose(read["k3"], 0.01, atol=SAME)
    np.testing.assert_allclose(read["readout"], np.exp(0.2) * 0.2, rtol=SAME)
    np.testing.assert_allclose(gain, [1, 1, np.exp(-0.1)], rtol=SAME)
    begins = np.exp(0.2) * camera.shutter.row_offset + 0.03
    np.testing.assert_allclose(after.shutter.row_offset, begins, atol=SAME)


def test_the_focal_length_of_a_polynomial_is_that_of_its_linear_coefficient():
    _, after, read, _ = changed(POLYNOMIAL, focal=0.1)
    np.testing.assert_allclose(read["focal"], np.exp(0.1) / 0.07, rtol=SAME)
    assert jnp.abs(after.lens.coefficients[1]) < 0.07
