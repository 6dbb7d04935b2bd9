"""What can be set on the page is what the configuration has, within its rules."""

import math

import pytest

from gaussray.camera.film import Film
from gaussray.config.compose import compose_config
from gaussray.render.rig.lens import LensOptions, build_lens
from gaussray.viewer.controls import (
    GROUPS,
    aperture_values,
    choice_values,
    consistent_values,
    flat_values,
    max_fov,
    nearest_choice,
    offered_choices,
    pinhole_values,
    sliders,
)


def begin():
    """Values as a configuration without words has them, made free of the capture."""
    values = {"render.samples": 4}
    for group, choice in zip(GROUPS, ("pinhole", "pinhole", "global", "none"), strict=True):
        values |= choice_values(group, choice)
    return values


def test_a_lens_has_no_one_or_two_blades():
    blades = next(one for one in sliders(3.0, 1.0) if one.key == "aperture.blades")
    assert [blades.value_at(shown) for shown in (0, 1, 2, 3, 9)] == [0, 0, 0, 3, 9]


def test_every_control_is_a_key_of_the_configuration():
    cfg = compose_config("view", ["scene=x"])
    for one in sliders(3.0, 1.0):
        group, name = one.key.split(".")
        assert name in cfg[group] and one.group == group
        assert one.low < one.high and 0 < one.step < one.high - one.low
        assert one.label and one.hint


@pytest.mark.parametrize(("distance", "span"), [(3.0, 1.0), (0.01, 300.0), (5e3, 0.0)])
def test_ranges_follow_the_scene(distance, span):
    ranges = {one.key: one for one in sliders(distance, span)}
    focus = ranges["aperture.focus_distance"]
    assert focus.low < distance < focus.high
    assert ranges["aperture.radius"].high == pytest.approx(distance / 10, rel=0.06)
    assert all(math.isfinite(x) for one in ranges.values() for x in one[2:5])


@pytest.mark.parametrize("group", GROUPS)
def test_a_choice_is_known_by_its_values(group):
    for name in offered_choices(group):
        assert nearest_choice(group, begin() | choice_values(group, name)) == name


def test_a_choice_stays_known_when_its_numbers_move():
    values = begin() | choice_values("lens", "fisheye") | {"lens.fov": 120.0}
    assert nearest_choice("lens", values) == "fisheye"
    values |= choice_values("aperture", "wide") | {"aperture.radius": 0.2}
    assert nearest_choice("aperture", values) == "wide"


def test_a_chosen_aperture_has_numbers_that_fit_the_focus():
    found = aperture_values("cat_eye", 0.5)
    assert found["aperture.focus_distance"] == 0.5 and found["aperture.radius"] == 0.018
    assert found["aperture.rim_radius"] == 0.018 and found["aperture.rim_distance"] == 0.03
    assert aperture_values("pinhole", 0.5)["aperture.focus_distance"] == 0.5


def test_what_says_nothing_is_hidden():
    shown = {one.key: one.is_visible(begin()) for one in sliders(3.0, 1.0)}
    assert not shown["aperture.focus_distance"] and not shown["shutter.readout"]
    values = begin() | choice_values("aperture", "wide") | choice_values("shutter", "rolling")
    shown = {one.key: one.is_visible(values) for one in sliders(3.0, 1.0)}
    assert shown["aperture.focus_distance"] and shown["shutter.readout"]
    assert not shown["shutter.field_time"]


@pytest.mark.parametrize("name", offered_choices("lens"))
def test_every_lens_that_is_offered_is_one_up_to_its_widest_field(name):
    values = begin() | choice_values("lens", name)
    for field in (values["lens.fov"], max_fov(values)):
        told = {**values, "lens.fov": field}
        block = {k.split(".")[1]: v for k, v in told.items() if k.startswith("lens.")}
        block = {k: tuple(v) if isinstance(v, list) else v for k, v in block.items()}
        assert build_lens(Film(64, 48), LensOptions(**block))


def test_wide_lenses_focus_on_a_sphere():
    assert (
        consistent_values(begin() | choice_values("lens", "equidistant"))["aperture.focus"]
        == "sphere"
    )
    wide = consistent_values(begin() | choice_values("lens", "equidistant"))
    assert consistent_values(wide | choice_values("lens", "pinhole"))["aperture.focus"] == "plane"


def test_the_pinhole_beside_an_effect_has_none():
    values = begin()
    for group, name in (("lens", "fisheye"), ("aperture", "wide"), ("sensor", "phone")):
        values |= choice_values(group, name)
    none = pinhole_values(values, 65.0)
    assert none["lens.model"] == "pinhole" and none["lens.fov"] == 65.0
    assert none["aperture.radius"] == 0 and none["sensor.gain"] == 1
    assert pinhole_values({**begin(), "lens.fov": 40.0}, 65.0)["lens.fov"] == 40.0


def test_blocks_of_a_file_become_values():
    told = {"lens": {"fov": 60.0, "k": [1.0]}, "scene": "x", "render": {"samples": 4}}
    assert dict(flat_values(told)) == {"lens.fov": 60.0, "lens.k": [1.0], "render.samples": 4}
