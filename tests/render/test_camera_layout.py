"""Cameras as rows of numbers: every camera gets its own, whichever was packed before it."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gaussray.camera.aperture import Aperture, Rim, with_edges
from gaussray.camera.camera import Camera
from gaussray.camera.lens.perspective import Pinhole
from gaussray.camera.placement import look_at
from gaussray.camera.shutter import Shutter, with_readout_factors
from gaussray.render.camera_layout import pack_camera


SIZE = (12, 8)


def camera(number: float, *, blades: int = 0, direction: str = "top_to_bottom", rim: bool = False):
    """A camera all of whose numbers follow from one."""
    edge = Rim(1.0 + number, 0.1) if rim else None
    return Camera(
        SIZE,
        Pinhole((20.0, 21.0 + number), (6.0, 4.0)),
        Aperture(0.1 * number, 2.0 + number, blades=blades, rim=edge),
        Shutter(0.1, 0.01 * number, 0.2, direction=direction),
        look_at((3.0, number, 1.0)),
        time=number,
    )


def expected(given: Camera) -> Camera:
    """The camera with blades and direction as data, by the classes themselves."""
    return dataclasses.replace(
        given,
        aperture=with_edges(given.aperture),
        shutter=with_readout_factors(given.shutter, SIZE),
    )


@pytest.mark.parametrize("host", [False, True])
@pytest.mark.parametrize(
    "kind",
    [
        {},
        {"blades": 5},
        {"blades": 6},
        {"direction": "right_to_left"},
        {"direction": "bottom_to_top"},
        {"rim": True},
    ],
)
def test_a_row_holds_the_numbers_of_its_own_camera(kind, host):
    for number in (1.0, 2.0, 3.5):
        given = camera(number, **kind)
        row, layout = pack_camera(jax.device_get(given) if host else given)
        found, wanted = layout.camera(jnp.asarray(row)), expected(given)
        assert jax.tree.structure(found) == jax.tree.structure(wanted)
        for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
            assert a.dtype == b.dtype
            np.testing.assert_array_equal(a, b)


def test_cameras_that_differ_in_blades_or_direction_share_a_layout():
    first = pack_camera(camera(1.0, blades=5))[1]
    assert first == pack_camera(camera(2.0, blades=7, direction="left_to_right"))[1]
    assert first != pack_camera(camera(1.0, rim=True))[1]
