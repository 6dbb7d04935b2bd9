"""Millimetres, f-numbers and milliseconds: what they amount to, and which cannot be."""

import dataclasses
import json
import re

import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.camera.camera import camera_ray
from gaussray.camera.trajectory import pose_at
from gaussray.render.rig import rig
from gaussray.render.rig.physical_units import (
    PhysicalOptions,
    apply_units,
    check_shape,
    to_scene_units,
    units_record,
)
from gaussray.render.rig.rig import ApertureOptions, LensOptions, RigOptions, ShutterOptions


# Double precision, and single precision where a camera is built.
EXACT, SINGLE = 1e-12, 2e-6
# 50 mm f/2 focused at 2 m on a frame 36 mm wide.
PORTRAIT = PhysicalOptions(
    focal_length=50.0,
    sensor=(36.0, 36.0),
    f_number=2.0,
    focus_distance=2.0,
    units_per_metre=1.0,
)


def filmed(views, given):
    options = apply_units(RigOptions(), given)
    return rig.frame_records(views, options=options, samples=1)[0].camera


def test_a_50_mm_lens_at_f_2_by_hand():
    values = to_scene_units(PORTRAIT)
    assert values["lens.fov"] == pytest.approx(39.59775270904986, abs=EXACT)
    assert values["aperture.radius"] == pytest.approx(0.0125, abs=EXACT)
    assert values["aperture.focus_distance"] == 2.0
    # In a scene counted in feet, and with the film where the lens has its image of 2 m.
    feet = dataclasses.replace(PORTRAIT, units_per_metre=3.25, breathing=True)
    values = to_scene_units(feet)
    assert values["aperture.radius"] == pytest.approx(0.0125 * 3.25, abs=EXACT)
    assert values["aperture.focus_distance"] == 6.5
    # v = f d / (d - f) = 100000 / 1950 mm.
    fov = np.rad2deg(2 * np.arctan(18 / (100000 / 1950)))
    assert values["lens.fov"] == pytest.approx(fov, abs=EXACT)


def test_times_by_hand():
    # A clip of 15 frames at 20 per second is 0.75 s, and the capture calls it 1.
    given = PhysicalOptions(readout=30.0, exposure=6.0, seconds_per_unit=0.75)
    assert to_scene_units(given) == pytest.approx(
        {"shutter.readout": 0.04, "shutter.exposure": 0.008}
    )
    half = PhysicalOptions(shutter_angle=180.0, frame_rate=24.0, seconds_per_unit=1.0)
    assert to_scene_units(half)["shutter.exposure"] == pytest.approx(1 / 48, abs=EXACT)


@pytest.mark.parametrize("breathing", [False, True])
def test_the_blur_of_a_point_is_the_thin_lens_s(views, breathing):
    """A point on the axis 4 m away is a disc on the film of diameter A |z - d|/z f/(d - f); if the
    film stays at the focal length, smaller by the ratio of their distances, (d - f)/d."""
    camera = filmed(views, dataclasses.replace(PORTRAIT, breathing=breathing))
    pose = camera.trajectory
    width, row = camera.film.width, camera.film.height / 2 - 0.5

    def miss(column, u):
        """How far right of the axis the ray of a pixel through the rim passes at 4 m."""
        u = toy.single([0.5, 0.5, u, 0.5, 0.5])
        ray = camera_ray(camera, toy.single([column, row]), u)
        seen = pose_at(pose, camera.time).inverse_apply(ray.origin)
        way = pose_at(pose, camera.time).inverse_apply(ray.origin + ray.direction) - seen
        return float(seen[0] + way[0] * 4 / way[2])

    def column(u):
        """The pixel whose ray meets the point: the miss is a straight line over the columns."""
        first, last = miss(0.0, u), miss(width - 1.0, u)
        return -first / (last - first) * (width - 1)

    spread = abs(column(1.0) - column(0.0)) * 36 / width
    thin_lens = 25 * (4 - 2) / 4 * 50 / (2000 - 50)
    assert thin_lens == pytest.approx(0.3205128, abs=1e-7)
    expected = thin_lens if breathing else thin_lens * (2000 - 50) / 2000
    # Directions in single precision, over a blur of a hundredth of the picture.
    assert spread == pytest.approx(expected, rel=1e-4)


def test_a_camera_has_what_was_given(views):
    given = dataclasses.replace(
        PORTRAIT, readout=30.0, exposure=6.0, seconds_per_unit=0.75, frame_rate=20.0
    )
    camera, shape = filmed(views, given), toy.SIZE
    np.testing.assert_allclose(camera.lens.focal, shape * 50 / 36, rtol=SINGLE)
    np.testing.assert_allclose(camera.aperture.radius, 0.0125, rtol=SINGLE)
    np.testing.assert_allclose(camera.shutter.row_step * (shape - 1), 0.04, rtol=SINGLE)
    np.testing.assert_allclose(camera.shutter.exposure, 0.008, rtol=SINGLE)
    far = filmed(views, dataclasses.replace(PORTRAIT, focus_distance=np.inf))
    assert jnp.isinf(far.aperture.focus_distance)


def test_what_is_not_given_stays():
    options = RigOptions(shutter=ShutterOptions("global", 0.0, 0.2))
    assert apply_units(options, PhysicalOptions()) == options
    assert units_record(options, PhysicalOptions()) == {}
    exposed = apply_units(RigOptions(), PhysicalOptions(exposure=5.0, seconds_per_unit=1.0))
    assert exposed == RigOptions(shutter=ShutterOptions("global", 0.0, 0.005))
    # A fisheye keeps its own field; the focal length is for the aperture.
    fisheye = RigOptions(lens=LensOptions("kannala_brandt", 150.0, (0.0,) * 4))
    given = dataclasses.replace(PORTRAIT, sensor=())
    assert apply_units(fisheye, given).lens == fisheye.lens
    assert apply_units(fisheye, given).aperture.radius == pytest.approx(0.0125)
    polynomial = RigOptions(lens=LensOptions("fisheye_polynomial", 166.0, (0.0,) * 5))
    small = PhysicalOptions(sensor=(24.0, 24.0))
    assert apply_units(polynomial, small).lens.sensor == (24.0, 24.0)


def test_a_manifest_has_both():
    told = units_record(RigOptions(), dataclasses.replace(PORTRAIT, focus_distance=np.inf))
    text = json.loads(json.dumps(told, allow_nan=False))["physical"]
    assert text["given"]["f_number"] == 2.0 and text["given"]["focus_distance"] == "infinity"
    assert "readout" not in text["given"]
    assert text["derived"]["aperture.radius"] == pytest.approx(0.0125)
    still = PhysicalOptions(readout=0.0, seconds_per_unit=1.0)
    assert units_record(RigOptions(), still)["physical"]["derived"]["shutter.readout"] == 0.0


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"f_number": 0.0}, "physical.f_number must be above 0, got 0.0"),
        ({"focal_length": -50.0}, "physical.focal_length must be above 0"),
        ({"focus_distance": 0.0}, "physical.focus_distance must be above 0"),
        (
            {"focus_distance": 0.05},
            "physical.focus_distance = 0.05 m must be beyond physical.focal_length = 50.0 mm",
        ),
        ({"sensor": (36.0,)}, "physical.sensor must be width and height in mm"),
        ({"sensor": (36.0, 0.0)}, "physical.sensor must be width and height in mm"),
        ({"units_per_metre": 0.0}, "physical.units_per_metre must be above 0"),
        ({"units_per_metre": None}, "physical.f_number needs physical.units_per_metre"),
        ({"focus_distance": None}, "physical.f_number needs physical.focus_distance"),
        ({"readout": -1.0}, "physical.readout must be at least 0, got -1.0"),
        ({"readout": 10.0}, "physical.readout needs physical.seconds_per_unit"),
        ({"shutter_angle": 400.0}, "physical.shutter_angle must be in 0 ... 360"),
        ({"shutter_angle": 90.0}, "physical.shutter_angle needs physical.frame_rate"),
        (
            {"exposure": 1.0, "shutter_angle": 90.0, "frame_rate": 24.0, "seconds_per_unit": 1.0},
            "physical.exposure = 1.0 and physical.shutter_angle = 90.0",
        ),
        (
            {"exposure": 60.0, "frame_rate": 20.0, "seconds_per_unit": 1.0},
            "physical.exposure = 60.0 ms must be at most the 50 ms of a frame "
            "(physical.frame_rate = 20.0)",
        ),
        (
            {"readout": 51.0, "frame_rate": 20.0, "seconds_per_unit": 1.0},
            "physical.readout = 51.0 ms must be at most the 50 ms",
        ),
    ],
)
def test_a_number_that_cannot_be_is_named(changed, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        dataclasses.replace(PORTRAIT, **changed)


TIMES = PhysicalOptions(readout=10.0, exposure=5.0, seconds_per_unit=1.0)
PULLED = ApertureOptions(focus_times=(0.0, 1.0), focus_distances=(2.0, 3.0))
BREATHING = dataclasses.replace(PORTRAIT, f_number=None, breathing=True)


@pytest.mark.parametrize(
    ("options", "given", "keys"),
    [
        (
            RigOptions(lens=LensOptions("pinhole", 80.0)),
            PORTRAIT,
            ("lens.fov = 80.0", "focal_length"),
        ),
        (
            RigOptions(aperture=ApertureOptions(0.09)),
            PORTRAIT,
            ("aperture.radius = 0.09", "f_number"),
        ),
        (
            RigOptions(aperture=ApertureOptions(focus_distance=3.0)),
            PORTRAIT,
            ("aperture.focus_distance = 3.0", "physical.focus_distance"),
        ),
        (
            RigOptions(shutter=ShutterOptions("rolling", 0.25)),
            TIMES,
            ("shutter.readout = 0.25", "physical.readout"),
        ),
        (
            RigOptions(shutter=ShutterOptions("rolling", 0.0, 0.1)),
            TIMES,
            ("shutter.exposure = 0.1", "physical.exposure"),
        ),
        (
            RigOptions(shutter=ShutterOptions("global", 0.0, 0.1)),
            PhysicalOptions(shutter_angle=90.0, frame_rate=24.0, seconds_per_unit=1.0),
            ("shutter.exposure = 0.1", "physical.shutter_angle"),
        ),
        (
            RigOptions(shutter=ShutterOptions("global")),
            TIMES,
            ("physical.readout = 10.0", "shutter.kind = global"),
        ),
        (
            RigOptions(shutter=ShutterOptions("table", row_times=(0.0,))),
            TIMES,
            ("physical.readout = 10.0", "shutter.kind = table"),
        ),
        (
            RigOptions(shutter=ShutterOptions("interlaced", row_step=0.1)),
            TIMES,
            ("physical.readout = 10.0", "shutter.row_step = 0.1"),
        ),
        (
            RigOptions(aperture=PULLED),
            BREATHING,
            ("aperture.focus_times", "physical.focus_distance"),
        ),
        (
            RigOptions(lens=LensOptions("fisheye_polynomial", sensor=(30.0, 30.0))),
            PORTRAIT,
            ("lens.sensor = (30.0, 30.0)", "physical.sensor"),
        ),
        (RigOptions(), PhysicalOptions(sensor=(36.0, 24.0)), ("physical.sensor", "focal_length")),
        (RigOptions(), PhysicalOptions(focal_length=50.0), ("focal_length", "physical.sensor")),
        (
            RigOptions(),
            PhysicalOptions(focus_distance=2.0, units_per_metre=1.0),
            ("physical.focus_distance", "physical.f_number"),
        ),
    ],
)
def test_a_contradiction_names_both_keys(options, given, keys):
    with pytest.raises(ValueError) as error:
        apply_units(options, given)
    assert all(key in str(error.value) for key in keys)


def test_a_sensor_has_the_shape_of_its_picture():
    def film(width, height):
        return toy.camera(width=width, height=height).film

    check_shape(PhysicalOptions(), [film(16, 16)])
    full = dataclasses.replace(PORTRAIT, sensor=(36.0, 24.0))
    check_shape(full, [film(1920, 1280), film(3, 2), film(1919, 1279)])
    with pytest.raises(ValueError, match="physical.sensor must have the shape .* 16 x 16 pixels"):
        check_shape(full, [film(3, 2), film(16, 16)])
