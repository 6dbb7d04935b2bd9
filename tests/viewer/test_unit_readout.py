"""The readout in photographic units inverts the conversion that `physical` makes."""

import pytest

from gaussray.render.rig.physical_units import PhysicalOptions, to_scene_units
from gaussray.viewer.unit_readout import physical_readout


VALUES = {
    "lens.model": "pinhole", "lens.fov": 60.0, "aperture.radius": 0.0,
    "aperture.focus_distance": 1.0, "shutter.kind": "global", "shutter.readout": 0.1,
    "shutter.exposure": 0.0,
}  # fmt: skip
UNITS = {"units_per_metre": 2.0, "seconds_per_unit": 4.0}


def test_nothing_is_said_where_units_are_not_known():
    assert physical_readout(VALUES, PhysicalOptions()) == ""


def test_a_camera_comes_back_as_it_was_given():
    given = PhysicalOptions(
        focal_length=50.0, sensor=(36.0, 24.0), f_number=2.8, focus_distance=3.0, readout=20.0,
        exposure=8.0, frame_rate=30.0, **UNITS,
    )  # fmt: skip
    values = VALUES | to_scene_units(given) | {"shutter.kind": "rolling"}
    expected = "50 mm on 36 mm · f/2.8 · focus 3 m · exposure 8 ms · readout 20 ms"
    assert physical_readout(values, given) == expected


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({}, "31.2 mm on 36 mm"),
        ({"lens.model": "equidistant"}, ""),
        ({"lens.model": "equidistant", "aperture.radius": 0.01}, "aperture 10 mm · focus 0.5 m"),
        ({"shutter.exposure": 0.01}, "31.2 mm on 36 mm · exposure 40 ms"),
    ],
)
def test_what_is_not_there_is_not_said(values, text):
    assert physical_readout(VALUES | values, PhysicalOptions(**UNITS)) == text
