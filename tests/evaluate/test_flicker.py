"""Flicker of films against the standard deviation of what was put into them."""

import tracemalloc

import numpy as np
import pytest

from gaussray.evaluate.flicker import Flicker
from gaussray.evaluate.scores import scores_text, summary


SIZE = (9, 7)
STILL = np.arange(63).reshape(SIZE) % 3 > 0
# Reports keep four digits.
DIGITS = 5e-5


def films(frames, tremble, seed=0):
    """Pictures of one mean whose codes differ from it by normal numbers."""
    dice = np.random.default_rng(seed)
    mean = dice.uniform(60, 190, (1, *SIZE, 3))
    noise = tremble * dice.normal(size=(frames, *SIZE, 3))
    return np.round(mean + noise).astype(np.uint8)


def deviation(*shown):
    """Of the still pixels of several cameras from their means, by NumPy."""
    square = [(x[:, STILL] - x[:, STILL].mean(axis=0)) ** 2 for x in shown]
    return np.sqrt(np.mean(np.concatenate([x.reshape(-1) for x in square])))


def seen(listed):
    """Flicker of (part, camera, truth, ours) films."""
    flicker = Flicker()
    for part, camera, truth, ours in listed:
        for one, other in zip(truth, ours, strict=True):
            flicker.add(part, camera, STILL, one, other)
    return flicker


def test_it_is_the_deviation_of_still_pixels_from_their_means_over_time():
    truth, ours = films(5, 1.0), films(5, 4.0, seed=1)
    # What moves counts nothing.
    ours[:, ~STILL] = np.random.default_rng(2).integers(0, 256, ours[:, ~STILL].shape)
    found = seen([("train", "cam_0", truth, ours)]).figures()
    assert found["flicker"] == pytest.approx(deviation(ours), abs=DIGITS)
    assert found["flicker_truth"] == pytest.approx(deviation(truth), abs=DIGITS)


def test_the_order_of_pictures_and_what_differs_between_cameras_do_not_count():
    one, other = films(6, 3.0), films(4, 3.0, seed=1)
    found = seen([("a", "cam_0", one, one), ("a", "cam_1", other, other)]).figures()
    assert found["flicker"] == pytest.approx(deviation(one, other), abs=DIGITS)
    mixed = one[np.random.default_rng(3).permutation(6)]
    again = seen([("a", "cam_1", other, other), ("a", "cam_0", mixed, mixed)])
    assert again.figures() == found


def test_a_film_in_two_parts_is_one_film_in_all():
    film = films(6, 3.0)
    flicker = seen([("train", "cam_0", film[:4], film[:4]), ("test", "cam_0", film[4:], film[4:])])
    assert flicker.figures()["flicker"] == pytest.approx(deviation(film), abs=DIGITS)
    assert flicker.figures("train")["flicker"] == pytest.approx(deviation(film[:4]), abs=DIGITS)
    assert flicker.figures("other") == {}


def test_a_single_picture_says_nothing_and_a_steady_film_has_none():
    film = films(1, 3.0)
    assert seen([("train", "cam_0", film, film)]).figures() == {}
    steady = np.repeat(film, 3, axis=0)
    found = seen([("train", "cam_0", steady, steady)]).figures()
    assert found == {"flicker": 0, "flicker_truth": 0}


def test_a_pixel_counts_in_the_pictures_that_show_it():
    truth, ours = films(6, 2.0), films(6, 4.0, seed=1)
    shown = np.random.default_rng(2).random((6, *SIZE)) < 0.5
    flicker = Flicker()
    for one, other, mask in zip(truth, ours, shown, strict=True):
        flicker.add("train", "cam_0", STILL, one, other, mask)
    square = []
    for y, x in np.argwhere(STILL):
        own = ours[shown[:, y, x], y, x].astype(float)
        if len(own) > 1:
            square.append((own - own.mean(axis=0)) ** 2)
    expected = np.sqrt(np.mean(np.concatenate(square)))
    assert flicker.figures()["flicker"] == pytest.approx(expected, abs=DIGITS)


def test_sums_are_of_static_pixels_alone():
    """Those of large pictures take hundreds of megabytes for each camera."""
    static, film = np.zeros((400, 300), bool), np.zeros((3, 400, 300, 3), np.uint8)
    static[:20] = True
    flicker = Flicker()
    tracemalloc.start()
    for picture in film:
        flicker.add("train", "cam_0", static, picture, picture, static)
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert held < 60 * static.sum()


def test_the_report_shows_it_beside_the_truths():
    flicker = seen([("train", "cam_0", films(5, 1.0), films(5, 4.0))])
    row = {"psnr": 20.0, "ssim": 0.5, "part": "train", "seconds": 0.5}
    found = summary([row], 1, flicker)
    assert found["flicker"] > 3 * found["flicker_truth"] > 0
    text = scores_text({"effects": {"pinhole": found}})
    assert f"{found['flicker']:.2f}" in text and "truth's" in text
    assert "flicker" not in scores_text({"effects": {"pinhole": summary([row], 1)}})
