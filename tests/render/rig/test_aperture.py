"""Lengths of an aperture: scene units, shares, and what is refused."""

import math

import pytest

from gaussray.render.rig.aperture import ApertureOptions, resolve_aperture


def never():
    raise AssertionError("nothing needs to be measured")


def resolved(measure=lambda: 1.23456, **keys):
    return resolve_aperture(ApertureOptions(**keys), measure)


def test_numbers_stay_and_nothing_is_measured():
    for keys in (
        {"radius": 0.09, "focus_distance": 2.5, "rim_radius": 0.1, "rim_distance": 0.2},
        {"radius": 0.09, "focus_distance": math.inf},
        {"radius": 0.0},
        {"radius": None},
        {"radius": 0.0, "focus_distance": "150%", "rim_radius": "3%"},
        {"radius": 0.1, "focus_times": (0.0, 1.0), "focus_distances": (2.0, 4.0)},
    ):
        assert resolved(never, **keys) == ApertureOptions(**keys)


def test_shares_are_of_the_focus_distance_and_have_three_digits():
    found = resolved(radius="3.6%", rim_radius="5%", rim_distance="6%")
    assert (found.focus_distance, found.radius) == (1.23, 0.0443)
    assert (found.rim_radius, found.rim_distance) == (0.0615, 0.0738)
    assert resolved(radius=0.1).focus_distance == 1.23
    assert resolved(radius=0.1, focus_distance="150%").focus_distance == 1.85
    assert resolved(never, radius="10%", focus_distance=2.0).radius == 0.2


def test_of_a_focus_pull_shares_are_of_the_nearest_distance_and_at_infinity_of_what_is_seen():
    pull = {"focus_times": (0.0, 1.0), "focus_distances": (3.0, 1.5)}
    assert resolved(never, radius="10%", **pull).radius == 0.15
    pull["focus_distances"] = (math.inf, math.inf)
    assert resolved(radius="10%", **pull).radius == 0.123
    far = resolved(radius="10%", focus_distance=math.inf)
    assert far.radius == 0.123 and far.focus_distance == math.inf


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"radius": "wide"}, "aperture.radius must be a number or a share .* got 'wide'"),
        ({"radius": "3.6"}, "aperture.radius must be a number or a share .* such as 3.6%"),
        ({"radius": "-1%"}, "aperture.radius must be a number or a share"),
        ({"radius": "0%"}, "aperture.radius must be a number or a share"),
        ({"radius": "auto"}, "aperture.radius must be a number or a share"),
        ({"radius": "nan%"}, "aperture.radius must be a number or a share"),
        ({"radius": -1.0}, "aperture.radius must be at least 0, got -1"),
        ({"radius": math.nan}, "aperture.radius must be at least 0, got nan"),
        ({"rim_radius": "x%"}, "aperture.rim_radius must be a number or a share"),
        ({"rim_distance": "inf%"}, "aperture.rim_distance must be a number or a share"),
        ({"focus_distance": "near"}, "aperture.focus_distance must be a number or auto"),
        ({"focus_distance": "0%"}, "aperture.focus_distance must be a number or auto"),
        ({"focus_distance": 0.0}, "aperture.focus_distance must be above 0, got 0.0"),
        ({"focus_distance": math.nan}, "aperture.focus_distance must be above 0, got nan"),
    ],
)
def test_what_is_no_length_is_refused_by_its_key(keys, message):
    with pytest.raises(ValueError, match=message):
        ApertureOptions(**keys)
