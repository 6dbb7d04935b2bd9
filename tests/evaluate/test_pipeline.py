"""Which pixels an evaluation counts."""

import dataclasses

import numpy as np
import pytest
import toy

from gaussray.camera.lens import Pinhole
from gaussray.capture.formats.paired import read_capture
from gaussray.capture.frames import read_encoded
from gaussray.dataset.images import write_image
from gaussray.evaluate import picture_scores
from gaussray.evaluate.masks import visible_mask
from gaussray.evaluate.options import EvaluateOptions
from gaussray.evaluate.pipeline import evaluate
from gaussray.render.options import RenderOptions


# Scores in a report are rounded to four places.
CLOSE = 1e-4


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    """A capture of one time whose lens turns back before the corners."""
    folder = toy.write_capture(tmp_path_factory.mktemp("capture"), toy.scene(speed=0), times=(0.0,))
    whole = read_capture(folder)

    def folded(views):
        lens = views[0].camera.lens
        bent = Pinhole(lens.focal, lens.center, [-0.6, 0.0, 0.0, 0.0])
        return [
            dataclasses.replace(view, camera=dataclasses.replace(view.camera, lens=bent))
            for view in views
        ]

    return whole.with_views(folded)


def scores(capture, out):
    report = evaluate(
        toy.scene(speed=0),
        capture,
        out,
        options=EvaluateOptions(),
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
