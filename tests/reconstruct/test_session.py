"""What is said when the pictures of a segment are read."""

from dataclasses import replace

import numpy as np
import pytest
import toy

from gaussray.capture.formats.paired import read_capture
from gaussray.dataset.images import write_image
from gaussray.reconstruct.log import RunLog
from gaussray.reconstruct.session import Session
from gaussray.reconstruct.shared_results import SharedResults


def test_a_plain_backdrop_is_told_once(tmp_path, capsys):
    capture = read_capture(toy.write_capture(tmp_path / "in", toy.scene(speed=0), times=(0.0,)))
    log, shared = RunLog(tmp_path / "out", resume=False, interval=0.0), SharedResults()
    Session(capture, log, toy.SHORT, False)
    assert "backdrop" not in capsys.readouterr().out
    for view in capture.views:
        picture = np.zeros((toy.SIZE, toy.SIZE, 3), np.uint8)
        picture[5:-5, 5:-5] = 200
        write_image(view.image, picture)
    Session(capture, log, toy.SHORT, True)
    assert "backdrop" not in capsys.readouterr().out
    for _ in range(2):
        Session(capture, log, toy.SHORT, False, shared=shared)
    assert capsys.readouterr().out.count("border is black: that is taken as a plain backdrop") == 1


def test_silhouettes_are_told_once_and_have_no_backdrop(tmp_path, capsys):
    capture = read_capture(toy.write_capture(tmp_path / "in", toy.scene(speed=0), times=(0.0,)))
    for i, view in enumerate(capture.views):
        picture = np.zeros((toy.SIZE, toy.SIZE, 4), np.uint8)
        row, column = 2 + 5 * (i % 2), 2 + 5 * (i // 2 % 2)
        picture[row : row + 7, column : column + 7] = 200, 100, 50, 255
        write_image(view.image, picture)
    capture = replace(capture, views=[replace(v, background="mask") for v in capture.views])
    log, shared = RunLog(tmp_path / "out", resume=False, interval=0.0), SharedResults()
    session = [Session(capture, log, toy.SHORT, False, shared=shared) for _ in range(2)][0]
    assert session.silhouettes and session.backdrop is None
    assert capsys.readouterr().out.count("Masks cut an object out of the pictures") == 1
    loss = replace(toy.SHORT.loss, outside_opacity=0.0)
    assert not Session(capture, log, replace(toy.SHORT, loss=loss), True).silhouettes


def test_opacity_costs_less_for_dark_pictures(tmp_path, capsys):
    capture = read_capture(toy.write_capture(tmp_path / "in", toy.scene(speed=0), times=(0.0,)))
    log = RunLog(tmp_path / "out", resume=False, interval=0.0)
    chosen = replace(toy.SHORT, density=replace(toy.SHORT.density, opacity_cost=0.1))
    options = replace(chosen, fit=replace(chosen.fit, auto=True))
    for view in capture.views:
        picture = np.zeros((toy.SIZE, toy.SIZE, 3), np.uint8)
        picture[:4] = 51
        write_image(view.image, picture)
    found = Session(capture, log, options, True).options.density
    Session(capture, log, options, False)
    assert "opacity costs 0.03 instead of 0.1 (density" in capsys.readouterr().out
    # A quarter of the pixels differs by a fifth, a third of the usual contrast.
    assert found.opacity_cost == pytest.approx(0.1 * 0.3)
    assert replace(found, opacity_cost=0.1) == options.density
    # What the user sets stays.
    explicit = replace(options, explicit_keys=("density.opacity_cost",))
    for own in (chosen, explicit):
        assert Session(capture, log, own, True).options.density.opacity_cost == 0.1
