"""fit=auto: how small pictures become, and what is said of it."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import toy

from gaussray.capture.capture import Capture, View
from gaussray.dataset.images import write_image
from gaussray.reconstruct.auto import picture_scale as module
from gaussray.reconstruct.auto.choice import auto_choice
from gaussray.reconstruct.auto.machine import Machine
from gaussray.reconstruct.auto.picture_scale import picture_scale
from gaussray.reconstruct.options import FitOptions, ReconstructOptions


CPU, GPU = Machine(gpu=False), Machine(gpu=True)
SIDE = 1000
MOST = CPU.most_pixels("none")


def photographs(count=12, times=(0.0,), mask=None):
    camera, path = toy.camera(0.0, 0.0, SIDE, SIDE), Path(__file__)
    views = [
        View(camera, path, mask, None, "a", "train", time, "pinhole", None, "srgb")
        for time in times
        for _ in range(count)
    ]
    return Capture(Path("folder"), views, {}, None, (min(times), max(times)), "normalised")


def choice(capture, machine=CPU, **fit):
    return auto_choice(capture, ReconstructOptions(fit=FitOptions(**fit)), machine)


def total(chosen):
    return sum(view.width * view.height for view in chosen.capture.views)


def test_more_minutes_keep_more_pixels_and_fewer_no_less():
    usual = choice(photographs())
    minutes = usual.options.fit.minutes
    assert total(usual) == pytest.approx(MOST, rel=0.01)
    assert total(choice(photographs(), minutes=minutes / 4)) == total(usual)
    assert total(choice(photographs(), minutes=2 * minutes)) == pytest.approx(2 * MOST, rel=0.01)
    whole = choice(photographs(), minutes=5 * minutes)
    assert whole.scale == 1 and "scaled" not in whole.sentence


@pytest.mark.parametrize("times", [(0.0,), (0.0, 1.0)])
@pytest.mark.parametrize("minutes", [0.0, 1.0, 7.0])
def test_the_line_names_the_minutes_that_keep_the_size(times, minutes):
    capture = photographs(times=times)
    found = choice(capture, minutes=minutes)
    said = re.search(r"to \d+ x \d+ \(fit.minutes=(\d+) keeps their size\)", found.sentence)
    assert said, found.sentence
    enough = float(said[1])
    assert choice(capture, minutes=enough).scale == 1 > choice(capture, minutes=enough - 1.5).scale


def test_numbers_of_steps_keep_the_size_and_no_minutes_are_named():
    found = choice(photographs(), coarse=10, minutes=100.0)
    assert found.scale < 1 and "keeps their size" not in found.sentence


def test_pixels_that_masks_hide_do_not_count(tmp_path, monkeypatch):
    shown = np.zeros((SIDE, SIDE, 3), np.float32)
    shown[: SIDE // 2] = 1.0
    write_image(tmp_path / "mask.png", shown)
    masked = photographs(mask=tmp_path / "mask.png")
    assert total(choice(masked)) == pytest.approx(2 * MOST, rel=0.01)
    # However little counts, pictures are read whole.
    shown[1:] = 0.0
    write_image(tmp_path / "mask.png", shown)
    assert total(choice(masked)) == pytest.approx(4 * MOST, rel=0.01)
    # A picture without a mask counts wholly.
    views = [
        replace(view, mask=view.mask if k % 2 else None) for k, view in enumerate(masked.views)
    ]
    assert MOST < total(choice(replace(masked, views=views))) < 2.2 * MOST
    monkeypatch.setattr(module, "visible_pixels", lambda view: pytest.fail("a mask is read"))
    # Masks are read only where that tells something.
    assert picture_scale(masked.views, GPU, "none", 1.0) == 1
    assert picture_scale(masked.views[:2], CPU, "none", 1.0) == 1
    assert picture_scale(photographs().views, CPU, "none", 1.0) < 1
