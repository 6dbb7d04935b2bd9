"""Flicker of films against the standard deviation of what was put into them."""

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


def test_the_report_shows_it_beside_the_truths():
    flicker = seen([("train", "cam_0", films(5, 1.0), films(5, 4.0))])
    row = {"psnr": 20.0, "ssim": 0.5, "part": "train", "seconds": 0.5}
    found = summary([row], 1, flicker)
    assert found["flicker"] > 3 * found["flicker_truth"] > 0
    text = scores_text({"effects": {"pinhole": found}})
    assert f"{found['flicker']:.2f}" in text and "truth's" in text
    assert "flicker" not in scores_text({"effects": {"pinhole": summary([row], 1)}})
