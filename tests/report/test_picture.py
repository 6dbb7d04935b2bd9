"""Pictures of a page are what they were, as far as there is room."""

import base64

import numpy as np
import pytest

from gaussray.dataset.images import write_image
from gaussray.report.picture import (
    BYTES,
    FULL,
    HEAT,
    SMALL,
    comparison_figure,
    embedded_image,
    error_map,
    picture_slider,
)


def noise(side):
    return np.random.default_rng(0).integers(0, 256, (side, side, 3), np.uint8)


def held(address):
    return base64.b64decode(address.split(",", 1)[1])


def test_a_small_picture_is_kept_to_the_last_bit(tmp_path):
    picture = noise(32)
    write_image(tmp_path / "a.png", picture)
    address = embedded_image(picture, 10_000)
    assert address.startswith("data:image/png")
    assert held(address) == (tmp_path / "a.png").read_bytes()


@pytest.mark.parametrize("most", [5_000, 40_000])
def test_a_large_picture_takes_no_more_than_it_may(most):
    address = embedded_image(noise(2 * SMALL), most)
    assert address.startswith("data:image/jpeg") and len(held(address)) <= most


def test_all_pictures_of_a_page_and_their_base64_leave_it_below_five_megabytes():
    assert BYTES * 4 / 3 < 4.5e6


def test_the_difference_map_is_black_where_nothing_differs_and_light_from_the_end_of_the_scale():
    truth = np.full((2, 3, 3), 100, np.uint8)
    ours = truth.copy()
    ours[0, 0], ours[0, 1] = 100 + FULL, 100 - FULL // 2
    found = error_map(truth, ours)
    assert tuple(found[1, 1]) == HEAT[0] and tuple(found[0, 0]) == HEAT[-1]
    assert HEAT[0] < tuple(found[0, 1]) < HEAT[-1]


def test_the_difference_map_is_black_where_a_mask_hides_the_picture():
    truth, shown = noise(16), np.arange(16) < 6 + np.zeros((16, 1))
    known = np.where(shown[..., None], 255 - truth, truth)
    figure = comparison_figure(truth, 255 - truth, [], shown=shown, most=9_000)
    assert embedded_image(error_map(truth, known), 9_000) in figure
    assert embedded_image(255 - truth, 9_000) in figure  # the rendering is as it is


def test_names_of_cameras_are_escaped_and_sliders_named():
    evil, picture = "<img src=x onerror=alert(1)>", noise(8)
    shown = comparison_figure(picture, picture, [evil], most=9_000)
    shown += picture_slider([(evil, picture), ("b", picture)], evil, most=9_000)
    assert "<img src=x" not in shown and "&lt;img" in shown
    assert shown.count('type="range"') == 2 and shown.count("aria-label=") == 2
