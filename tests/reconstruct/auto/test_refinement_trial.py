"""Corrections of cameras are kept only where pictures that they have not seen gain."""

import json
from dataclasses import replace

import numpy as np
import pytest
import toy

from gaussray.capture.formats.paired import read_capture
from gaussray.dataset.images import write_image
from gaussray.dataset.manifest import write_manifest
from gaussray.reconstruct.auto.refinement_trial import (
    kept_corrections,
    refinement_sentence,
    with_refinement_tried,
)
from gaussray.reconstruct.auto.trial_fits import TrialFits
from gaussray.reconstruct.data import held_out_tiles
from gaussray.reconstruct.data.segments import segments
from gaussray.reconstruct.pipeline import reconstruct
from gaussray.reconstruct.shared_results import SharedResults
from gaussray.render.options import RenderOptions
from gaussray.render.renderer import Renderer


pytestmark = pytest.mark.usefixtures("known_sizes")


def test_a_correction_is_kept_beside_those_that_are_kept_already():
    known = {(): 20.0, ("pose",): 20.04, ("lens",): 20.5, ("lens", "offset"): 21.0}
    asked = []

    def score(chosen):
        asked.append(chosen)
        return known[chosen]

    kept, scores = kept_corrections(["pose", "lens", "offset"], score, 0.05)
    assert kept == ("lens", "offset") and asked == list(known)
    assert scores == {"": 20.0, "pose": 20.04, "lens": 20.5, "offset": 21.0}
    assert refinement_sentence(kept, scores) == (
        "Held-out tiles: recorded cameras 20.00 dB, pose 20.04 dB (left as recorded), "
        "lens 20.50 dB (kept), offset 21.00 dB (kept)."
    )


def test_a_fit_that_fails_keeps_nothing():
    assert kept_corrections(["pose"], lambda chosen: 0.0 if chosen else 20.0, 0.0)[0] == ()


GAIN = dict(zip(toy.CAMERAS, (0.6, 1.0, 1.3, 1.1), strict=True))


def capture_of(folder, gains):
    """The toy's capture of one instant, whose steps compile quickly, with gains of the cameras."""
    renderer = Renderer(toy.scene(), options=RenderOptions(samples=1), trace=toy.TRACE)
    records = toy.records(times=(0.0,))
    for record in records:
        light = renderer(record.camera).color * np.float32(gains.get(record.camera_name, 1.0))
        write_image(folder / record.file_path, light)
    write_manifest(folder / "transforms.json", records, extra={"ply_file_path": "points3d.ply"})
    toy.write_points(folder / "points3d.ply", toy.scene())
    return read_capture(folder)


def options(**fit):
    fast = replace(toy.SHORT.optimizer, exposure=0.1)
    return replace(
        toy.SHORT,
        fit=replace(toy.SHORT.fit, refine=("exposure",), coarse=60, fine=60, **fit),
        optimizer=fast,
    )


@pytest.mark.ci
def test_wrong_exposures_are_refined_and_equal_ones_are_not(tmp_path, capsys):
    wrong = capture_of(tmp_path / "wrong", GAIN)
    reconstruct(wrong, tmp_path / "a", options=options())
    said = capsys.readouterr().out
    found = json.loads((tmp_path / "a/refine.json").read_text())
    assert found["kept"] == ["exposure"] and found["psnr"]["exposure"] > found["psnr"][""] + 1
    assert "dB (kept)" in said and not list(tmp_path.glob("a/trial*"))
    gain = json.loads((tmp_path / "a/cameras.json").read_text())["info"]["gain"]
    assert gain["cam_0"][0] < 1 < gain["cam_2"][0]
    reconstruct(capture_of(tmp_path / "right", {}), tmp_path / "b", options=options())
    assert "exposure" in capsys.readouterr().out
    assert json.loads((tmp_path / "b/refine.json").read_text())["kept"] == []
    assert "info" not in json.loads((tmp_path / "b/cameras.json").read_text())


def test_without_tiles_to_spare_cameras_are_left_as_recorded(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(held_out_tiles, "_TRIAL_SHARE", 0.0)
    monkeypatch.setattr("gaussray.reconstruct.auto.refinement_trial._SHARE", 0.0)
    capture = capture_of(tmp_path / "c", GAIN)
    reconstruct(capture, tmp_path / "a", options=options())
    said = capsys.readouterr().out
    assert "cameras are left as recorded" in said and "fit.refine_gain=-1" in said
    assert "info" not in json.loads((tmp_path / "a/cameras.json").read_text())
    assert json.loads((tmp_path / "a/refine.json").read_text()) == {"kept": [], "psnr": {}}


def test_a_run_that_is_resumed_goes_by_its_own_trial(tmp_path):
    capture = capture_of(tmp_path / "capture", {})
    part = segments(capture, 0)[0]

    def fitted(*_):
        raise AssertionError("nothing is fitted")

    def tried(**fit):
        fits = TrialFits(capture, part, tmp_path, fitted, SharedResults())
        return with_refinement_tried(fits, options(**fit), resume=True).fit.refine

    assert tried() == ("exposure",)
    (tmp_path / "refine.json").write_text('{"kept": []}')
    assert tried() == ()
    assert tried(refine_gain=-1) == ("exposure",)
