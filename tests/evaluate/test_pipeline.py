"""Which pixels an evaluation counts."""

import dataclasses
import json

import numpy as np
import pytest
import toy

from gaussray.camera.lens import Pinhole
from gaussray.capture.formats.paired import read_capture
from gaussray.capture.frames import read_encoded
from gaussray.capture.picture_file import read_levels
from gaussray.color import srgb_decode
from gaussray.dataset.images import srgb_levels, write_image
from gaussray.evaluate import picture_scores, pipeline
from gaussray.evaluate.found_cameras import FoundCapture
from gaussray.evaluate.masks import levels_and_mask, visible_mask
from gaussray.evaluate.metrics import ssim
from gaussray.evaluate.options import EvaluateOptions
from gaussray.evaluate.pipeline import evaluate
from gaussray.render.options import RenderOptions
from gaussray.render.renderer import Renderer


# Scores in a report are rounded to four places.
CLOSE = 1e-4


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    """A capture of one time whose lens turns back before the corners."""
    folder = toy.write_capture(tmp_path_factory.mktemp("capture"), toy.scene(speed=0), times=(0.0,))
    whole = read_capture(folder)

    return whole.with_views(bent_views)


def bent_views(views):
    lens = views[0].camera.lens
    bent = Pinhole(lens.focal, lens.center, [-0.6, 0.0, 0.0, 0.0])
    return [
        dataclasses.replace(view, camera=dataclasses.replace(view.camera, lens=bent))
        for view in views
    ]


def scores(capture, out, options=None):
    report = evaluate(
        toy.scene(speed=0),
        capture,
        out,
        options=options or EvaluateOptions(),
        render=RenderOptions(samples=1),
        trace=toy.TRACE,
        quiet=True,
    )
    return report["effects"]["pinhole"]


def test_pixels_that_a_pinhole_lens_leaves_without_a_ray_do_not_count(capture, tmp_path):
    (view,) = [view for view in capture.views if view.split == "test"]
    visible = visible_mask(view.camera)
    assert visible is not None and 0.05 < 1 - visible.mean() < 0.9
    before = scores(capture, tmp_path / "before")
    picture = read_encoded(view).copy()
    picture[~visible] = 255 - picture[~visible]
    write_image(view.image, picture)
    after = scores(capture, tmp_path / "after")
    assert before["psnr"] == pytest.approx(after["psnr"], abs=CLOSE)
    assert before["psnr"] == pytest.approx(before["psnr_masked"], abs=CLOSE)
    assert before["ssim"] == pytest.approx(before["ssim_masked"], abs=CLOSE)
    assert np.isfinite(before["psnr"])


def test_ssim_is_the_same_whether_a_corner_has_a_ray_or_not(capture, tmp_path, monkeypatch):
    """The corner and the rim around it lie in the border that SSIM leaves out."""

    def lacking(count):
        def visible(camera):
            mask = np.ones((camera.film.height, camera.film.width), bool)
            mask[:count, :count] = False
            return mask if count else None

        return visible

    found = {}
    for count in (0, 2, 7):
        monkeypatch.setattr(picture_scores, "visible_mask", lacking(count))
        found[count] = scores(capture, tmp_path / str(count))
    assert found[2]["ssim"] == pytest.approx(found[0]["ssim"], abs=CLOSE)
    assert found[2]["ssim_masked"] == pytest.approx(found[0]["ssim"], abs=CLOSE)
    # One that reaches further in does count.
    assert found[7]["ssim"] != pytest.approx(found[0]["ssim"], abs=CLOSE)


def masked(folder, hidden, dark=()):
    """A capture whose masks hide columns at the left of each picture, or all of some, and whose
    pictures are darker than the scene."""
    content = json.loads((folder / "transforms.json").read_text())
    for frame in content["frames"]:
        white = np.full((toy.SIZE, toy.SIZE), 255, np.uint8)
        white[:, :hidden] = 0
        white[:] *= frame["camera"] not in dark
        frame["mask_path"] = f"masks/{frame['camera']}.png"
        (folder / "masks").mkdir(exist_ok=True)
        write_image(folder / frame["mask_path"], white)
    (folder / "transforms.json").write_text(json.dumps(content))
    capture = read_capture(folder)
    for view in capture.views:
        write_image(view.image, read_encoded(view) // 2)
    return capture


def spoil(views, hidden):
    """Invert what the masks hide."""
    for view in views:
        picture = read_encoded(view).copy()
        picture[:, :hidden] = 255 - picture[:, :hidden]
        write_image(view.image, picture)


def test_a_camera_s_known_exposure_is_no_error_and_an_unknown_one_is_matched(tmp_path):
    folder = tmp_path / "capture"
    toy.write_capture(folder, toy.scene(speed=0), times=(0.0,))
    truth, gain = read_capture(folder), np.array([0.5, 0.8, 0.4])
    (view,) = [view for view in truth.views if view.split == "test"]
    write_image(view.image, srgb_levels(gain * srgb_decode(read_encoded(view) / 255)))
    unknown = scores(truth, tmp_path / "unknown")
    assert unknown["psnr"] < 25 and unknown["psnr_matched"] > 45
    assert unknown["exposure_stops"] > 0.5
    responses = {(view.camera_name, view.image.parent.resolve()): np.diag(gain)}
    known = scores(FoundCapture(truth, responses), tmp_path / "known")
    # Up to rounding; a table of equal exposures has no column of matched ones.
    assert known["psnr"] > 45 and "psnr_matched" not in known
    report = json.loads((tmp_path / "unknown/report.json").read_text())
    assert any("fit.refine=[exposure]" in text for text in report["remarks"])


def test_opacity_outside_masks_that_cut_something_out_is_a_score(tmp_path):
    folder, half = tmp_path / "capture", toy.SIZE // 2
    toy.write_capture(folder, toy.scene(speed=0), times=(0.0,))
    plain = scores(masked(folder, half), tmp_path / "plain")
    # Masks that hide the same of each picture cut nothing out.
    assert "opacity_outside_masks" not in plain
    names = sorted({view.camera_name for view in read_capture(folder).views})
    for k, name in enumerate(names):
        white = np.zeros((toy.SIZE, toy.SIZE), np.uint8)
        row, column = divmod(k % 4, 2)
        white[row * half : (row + 1) * half, column * half : (column + 1) * half] = 255
        write_image(folder / f"masks/{name}.png", white)
    truth = read_capture(folder)
    found = scores(truth, tmp_path / "cut")
    (view,) = [view for view in truth.views if view.split == "test"]
    shown = levels_and_mask(view)[1]
    renderer = Renderer(toy.scene(speed=0), options=RenderOptions(samples=1), trace=toy.TRACE)
    opacity = renderer(view.camera).alpha[~shown].mean()
    assert 0.1 < opacity < 1
    assert found["opacity_outside_masks"] == pytest.approx(float(opacity), abs=CLOSE)
    assert found["shown_share"] == 0.25
    assert found["psnr_masked"] == found["psnr"] and found["ssim_masked"] == found["ssim"]
    report = json.loads((tmp_path / "cut/report.json").read_text())
    assert any("loss.outside_opacity" in text for text in report["remarks"])


@pytest.mark.parametrize("bent", [False, True])
def test_only_white_pixels_of_a_mask_count(tmp_path, bent):
    folder, hidden = tmp_path / "capture", toy.SIZE // 2
    toy.write_capture(folder, toy.scene(speed=0), times=(0.0,))
    truth = masked(folder, hidden)
    if bent:
        truth = truth.with_views(bent_views)
    (view,) = [view for view in truth.views if view.split == "test"]
    before = scores(truth, tmp_path / "before")
    assert np.isfinite(before["psnr"])
    whole = read_encoded(view)
    spoil([view], hidden)
    after = scores(truth, tmp_path / "after")
    assert {k: v for k, v in after.items() if k != "fps"} == {
        k: v for k, v in before.items() if k != "fps"
    }
    stored = read_levels(tmp_path / "after/pinhole/cam_3_0.0000.png", 3 * toy.SIZE, toy.SIZE)
    real, ours, difference = (stored[:, k * toy.SIZE : (k + 1) * toy.SIZE] for k in range(3))
    assert not difference[:, :hidden].any() and (real[:, :hidden] != ours[:, :hidden]).any()
    if not bent:
        error = np.mean((whole[:, hidden:].astype(float) - ours[:, hidden:]) ** 2) / 255**2
        assert after["psnr"] == pytest.approx(-10 * np.log10(error), abs=CLOSE)
        # Windows of SSIM reach into hidden pixels, which are black in both.
        white = np.arange(toy.SIZE) >= hidden + np.zeros((toy.SIZE, 1))
        seen = [picture * white[..., None] for picture in (real, ours)]
        assert after["ssim"] == pytest.approx(ssim(*seen, white), abs=CLOSE)
        assert after["ssim"] != pytest.approx(ssim(*seen), abs=10 * CLOSE)


def test_what_a_mask_hides_neither_moves_nor_flickers(tmp_path):
    folder, hidden = tmp_path / "capture", toy.SIZE // 2
    toy.write_capture(folder, toy.scene(speed=0), times=toy.TIMES)
    truth = masked(folder, hidden)
    before = scores(truth, tmp_path / "before")
    assert before["flicker"] == before["flicker_truth"] == 0 and "psnr_moving" not in before
    spoil(truth.views[::2], hidden)
    after = scores(truth, tmp_path / "after")
    assert after["flicker"] == after["flicker_truth"] == 0 and "psnr_moving" not in after
    assert after["psnr"] == pytest.approx(before["psnr"], abs=CLOSE)


def test_a_picture_that_is_hidden_has_no_score(tmp_path):
    folder = tmp_path / "capture"
    toy.write_capture(folder, toy.scene(speed=0), times=(0.0,))
    first, *_ = names = [view.camera_name for view in read_capture(folder).views]
    options = EvaluateOptions(split="all")
    hidden = scores(masked(folder, 4, [first]), tmp_path / "a", options)
    others = scores(masked(folder, 4, names), tmp_path / "b", options)
    lines = [json.loads(x) for x in (tmp_path / "a/scores.jsonl").read_text().splitlines()]
    assert ["psnr" in x for x in lines] == [x["camera"] != first for x in lines]
    known = [x["psnr"] for x in lines if "psnr" in x]
    assert hidden["psnr"] == pytest.approx(np.mean(known), abs=CLOSE)
    assert "psnr" not in others and others["frames"] == len(names)


def test_a_perceptual_metric_is_a_mean_over_what_is_shown(tmp_path, monkeypatch):
    folder, hidden = tmp_path / "capture", toy.SIZE // 4
    toy.write_capture(folder, toy.scene(speed=0), times=(0.0,))
    truth = masked(folder, hidden)

    def flip(real, ours, shown):
        errors = blurred(np.abs(real.astype(float) - ours).mean(axis=-1))
        return float(errors.mean() if shown is None else errors[shown].mean())

    monkeypatch.setattr(pipeline, "perceptual_metrics", lambda: {"flip": flip})
    (view,) = [view for view in truth.views if view.split == "test"]
    whole = read_encoded(view)
    spoil([view], hidden)
    found = scores(truth, tmp_path / "out")["flip"]
    stored = read_levels(tmp_path / "out/pinhole/cam_3_0.0000.png", 3 * toy.SIZE, toy.SIZE)
    ours = stored[:, toy.SIZE : 2 * toy.SIZE]
    errors = np.abs(whole.astype(float) - ours).mean(axis=-1)
    errors[:, :hidden] = 0
    assert found == pytest.approx(blurred(errors)[:, hidden:].mean(), abs=CLOSE)
    # The error spreads to what is hidden.
    assert blurred(errors)[:, :hidden].any()


def blurred(errors):
    """Means over five columns."""
    padded = np.pad(errors, ((0, 0), (2, 2)))
    return np.mean([padded[:, k : k + errors.shape[1]] for k in range(5)], axis=0)
