"""Sentences below the scores: each is there only where it is true."""

import dataclasses

import numpy as np
import pytest
import toy

from gaussray.capture.formats.paired import read_capture
from gaussray.evaluate.found_cameras import FoundCapture
from gaussray.evaluate.remarks import remarks


HELD = {"held_out_cameras"}


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    folder = tmp_path_factory.mktemp("capture")
    return read_capture(toy.write_capture(folder, toy.scene(speed=0), times=(0.0,)))


def of(capture, parts=HELD, responses=None, **row):
    found = FoundCapture(capture, responses or {})
    return remarks({"effects": {"pinhole": row}}, set(parts), found)


def test_usual_scores_need_no_remark(capture):
    assert of(capture, psnr=25.0) == []
    slight = {"psnr_matched": 25.5, "exposure_stops": 0.2, "opacity_outside_masks": 0.1}
    assert of(capture, psnr=25.0, shown_share=1.0, **slight) == []
    assert of(capture, psnr=None, psnr_matched=None) == []


def test_masks_and_the_fog_that_they_hide_are_told(capture):
    masks, fog = of(capture, psnr=25.0, shown_share=0.19, opacity_outside_masks=0.31)
    assert "19 %" in masks
    assert "0.31" in fog and "loss.outside_opacity" in fog


def test_exposures_that_explain_an_error_are_told_with_the_remedy(capture):
    row = {"psnr": 25.0, "psnr_matched": 25.6, "exposure_stops": 0.4}
    (sentence,) = of(capture, **row)
    assert "0.6 dB" in sentence and "0.4 stops" in sentence
    assert "fit.refine=[exposure]" in sentence
    known = {("cam_0", capture.folder): np.eye(3)}
    (sentence,) = of(capture, responses=known, **row)
    assert "fit.refine" not in sentence and "exposure-matched" in sentence


def test_scores_of_fitted_cameras_alone_are_told(capture):
    (sentence,) = of(capture, parts={"train", "held_out_times"})
    assert sentence.startswith("Only pictures of fitted cameras") and "evaluate.split" in sentence
    train = [view for view in capture.views if view.split == "train"]
    (sentence,) = of(dataclasses.replace(capture, views=train), parts={"train"})
    assert "capture.test=[CAMERA]" in sentence
    (sentence,) = of(dataclasses.replace(capture, views=train[:1]), parts={"train"})
    assert "capture.test" not in sentence and "evaluate.split" not in sentence


def test_an_effect_is_named_where_there_are_several(capture):
    row = {"psnr": 25.0, "shown_share": 0.5}
    found = remarks(
        {"effects": {"pinhole": {"psnr": 20.0}, "fisheye": row}}, HELD, FoundCapture(capture)
    )
    assert len(found) == 1 and found[0].startswith("fisheye: ")
