"""The demo: from pictures to scored effects in one command, with everything that it promises."""

import json

import numpy as np
import pytest
import toy

from gaussray.capture.calibration import read_capture
from gaussray.capture.frames import read_image
from gaussray.cli import main
from gaussray.scene.store import load_scene


pytestmark = pytest.mark.usefixtures("quick_compilation")


@pytest.fixture(scope="module")
def demo(tmp_path_factory, quick_compilation):
    """The demo of a paired capture with one effect, and where it left its files."""
    folder = tmp_path_factory.mktemp("demo")
    truth = toy.write_paired(folder / "truth", toy.scene())
    main(["demo", f"capture.path={truth}", f"out={folder}/out", "quiet=true", *toy.TINY])
    return read_capture(truth), folder / "out"


def test_the_report_holds_the_scores_of_every_effect_and_of_the_training_views(demo):
    _, out = demo
    report = json.loads((out / "report.json").read_text())
    assert report["frames"] == 4 and report["train"]["frames"] == 9
    assert set(report["effects"]) == {"pinhole", "rolling_shutter"}
    for row in (report["train"], *report["effects"].values()):
        assert np.isfinite(row["psnr"]) and np.isfinite(row["ssim"])
    seconds = report["seconds"]
    assert set(seconds) == {"reconstruct", "evaluate", "total"} and min(seconds.values()) > 0
    scene = load_scene(out)
    assert report["scene"]["gaussians"] == scene.static.count + scene.moving.count
    assert report["scene"]["moving"] == scene.moving.count


def test_pictures_and_videos_show_truth_and_ours(demo):
    truth, out = demo
    views = {"pinhole": [v for v in truth.views if v.split == "test"], **truth.effects}
    for effect, listed in views.items():
        found = sorted((out / effect).glob("*.png"))
        assert len(found) == len(listed)
        for path, view in zip(found, sorted(listed, key=lambda v: v.time), strict=True):
            shown = read_image(path, 3 * toy.SIZE, toy.SIZE)
            expected = read_image(view.image, toy.SIZE, toy.SIZE)
            np.testing.assert_array_equal(shown[:, : toy.SIZE], expected)
            assert (shown[:, toy.SIZE : 2 * toy.SIZE] != expected).any()
        assert (out / effect / "cam_3.mp4").stat().st_size > 0
    assert (out / "contact_sheet.png").stat().st_size > 0


def test_nothing_half_done_is_left(demo):
    _, out = demo
    assert not (out / "checkpoint.npz").exists() and not (out / "train").exists()
    assert {"scene.npz", "cameras.json", "metrics.jsonl", "config.yaml"} <= {
        path.name for path in out.iterdir()
    }
