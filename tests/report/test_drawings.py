"""Cameras are drawn as they stand and as they see."""

import dataclasses
import re

import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.camera.aperture import Aperture
from gaussray.camera.lens import KannalaBrandt
from gaussray.report import optics
from gaussray.report.plan import drawing_axes, edge_directions


DEGREES = 1e-3


def test_edges_of_a_pinhole_are_those_of_its_field_of_view():
    camera = toy.camera()
    expected = 2 * np.degrees(np.arctan(toy.SIZE / 2 / (1.1 * toy.SIZE)))
    assert optics.field_of_view(camera) == pytest.approx((expected, expected), abs=DEGREES)


def test_a_lens_that_sees_behind_itself_has_more_than_180_degrees():
    half = toy.SIZE / 2
    lens = KannalaBrandt(
        toy.single([half / np.radians(110)] * 2),
        toy.single([half] * 2),
        toy.single([0.0] * 4),
        toy.single(3.0),
    )
    camera = dataclasses.replace(toy.camera(), lens=lens)
    assert optics.field_of_view(camera)[0] == pytest.approx(220, abs=0.1)


def test_up_is_what_the_cameras_take_for_it_and_the_axes_are_square():
    turn = np.stack([np.asarray(toy.camera(angle).trajectory.quat)[0] for angle in (-0.4, 0.4)])
    from gaussray.geometry import rotation_matrix

    axes = np.array(drawing_axes(np.asarray(rotation_matrix(jnp.asarray(turn)))))
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-6)
    np.testing.assert_allclose(axes[1], [0, -1, 0], atol=1e-6)  # image rows point down


def test_beams_meet_where_the_camera_is_focused():
    camera = toy.camera()
    aperture = Aperture(*(toy.single(x) for x in (0.2, 2.5, 0.0, 1.0)))
    camera = dataclasses.replace(camera, aperture=aperture)
    origin, direction = optics.drawn_rays(camera, np.array([0.2, 0.8]), np.linspace(0, 0.99, 5))
    meet = origin + direction * ((2.5 - origin[..., 2:]) / direction[..., 2:])
    np.testing.assert_allclose(meet, np.broadcast_to(meet[:, :1], meet.shape), atol=1e-5)
    assert np.ptp(origin[..., 0]) > 0.3


def test_a_shutter_is_drawn_unless_instantaneous_and_an_aperture_if_there_is_one():
    still, moving = toy.camera(), toy.rolling(toy.camera())
    assert len(optics.camera_drawings("a", still, "s")) == 1
    drawn = optics.camera_drawings("a", moving, "s")
    assert len(drawn) == 2 and "readout 0.2, exposure 0 (s)" in drawn[1]


def test_no_drawing_has_a_number_that_is_none():
    wide = dataclasses.replace(
        toy.rolling(toy.camera()), aperture=Aperture(*(toy.single(x) for x in (0.2, 2.5, 0.0, 1.0)))
    )
    for figure in optics.camera_drawings("a", wide, "s"):
        assert not re.search(r"\b(nan|inf)\b", figure)
    assert np.isfinite(edge_directions(wide)).all()
