"""Fits of captures with variants of options: their options, their scores and rows of tables."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from experiments.captures.fits import varied
from experiments.captures.gsplat_mcmc import focus
from experiments.captures.moving import BASE, HEAD, VARIANTS, line, mean_scores, nearest_cameras
from gaussray.camera.camera import Camera
from gaussray.camera.lens.perspective import Pinhole
from gaussray.camera.placement import look_at
from gaussray.capture.open import open_capture
from gaussray.evaluate.metrics import psnr
from gaussray.reconstruct.data.segments import training_views


def test_a_variant_changes_the_options_in_order_and_settings_come_last():
    options = varied(BASE, "stereo+nobodies+seed1", VARIANTS, ["fit.seed=3", "fit.start=given"])
    assert (options.fit.start, options.fit.seed, options.track.poses) == ("given", 3, 0)
    assert options.fit.auto
    # A setting counts also where it is the default.
    assert varied(BASE, "auto", VARIANTS, [f"fit.fine={BASE.fit.fine}"]).explicit_keys == (
        "fit.fine",
    )


def test_the_nearest_cameras_to_a_held_out_one_are_kept_alone():
    sample = open_capture(Path(__file__).parents[1] / "experiments/quickstart/capture")
    few = nearest_cameras(sample, 3)
    place = {
        view.camera_name: np.asarray(view.camera.trajectory.translation)[0] for view in sample.views
    }
    kept = {view.camera_name: view.split for view in few.views}
    (held_out,) = (name for name, split in kept.items() if split == "test")
    far = {
        split: [np.linalg.norm(place[name] - place[held_out]) for name in names]
        for split, names in (
            ("kept", [name for name, split in kept.items() if split == "train"]),
            ("left", {v.camera_name for v in sample.views if v.split == "train"} - set(kept)),
        )
    }
    assert len(far["kept"]) == 3 and max(far["kept"]) <= min(far["left"])
    with pytest.raises(SystemExit, match="--nearest needs a camera that is held out"):
        nearest_cameras(replace(sample, views=training_views(sample)), 3)


def test_every_variant_makes_valid_options():
    for name in VARIANTS:
        varied(BASE, name, VARIANTS, [])


def test_pooled_psnr_is_that_of_all_moving_pixels_together():
    rng = np.random.default_rng(0)
    truth, image = rng.integers(0, 256, (2, 3, 8, 8, 3), dtype=np.uint8)
    masks = rng.random((3, 8, 8)) < 0.3
    rows = []
    for a, b, mask in zip(truth, image, masks, strict=True):
        error = (a.astype(float) - b)[mask] / 255
        rows.append({"psnr": psnr(a, b), "ssim": 0.0, "moving": psnr(a, b, mask)})
        rows[-1] |= {"squared": float(np.sum(error**2)), "values": error.size}
    means = mean_scores(rows)
    error = (truth.astype(float) - image)[masks] / 255
    assert means["pooled"] == pytest.approx(-10 * np.log10(np.mean(error**2)), abs=1e-9)
    assert means["moving"] == pytest.approx(np.mean([row["moving"] for row in rows]), abs=1e-12)


def test_a_picture_in_which_nothing_moves_counts_as_a_whole_alone():
    still, moving = {"psnr": 30.0, "ssim": 0.9}, {"psnr": 20.0, "ssim": 0.7, "moving": 15.0}
    means = mean_scores([still, moving | {"squared": 0.1, "values": 10}])
    assert (means["psnr"], means["moving"]) == (25.0, 15.0)
    assert means["pooled"] == pytest.approx(20.0, abs=1e-9)


def test_a_row_has_a_figure_for_each_heading(tmp_path):
    keys = ("psnr", "moving", "pooled", "ssim", "between_psnr", "between_moving")
    keys += ("training_psnr", "training_moving", "seconds")
    row = dict.fromkeys((*keys, "steps", "static", "moving_ones", "transient"), 1.0)
    assert line(tmp_path, "given", row).count("|") == len(HEAD) + 1


def test_the_point_that_cameras_look_at_is_where_their_axes_meet():
    target = np.array([0.3, -0.2, 1.0])
    eyes = target + 2.0 * np.array([[1, 0, 0], [0, 1, 0], [0, 0.6, 0.8], [-0.8, 0, 0.6]])
    lens = Pinhole((8.0, 8.0), (4.0, 4.0))
    places = [(tuple(eye), tuple(target.tolist())) for eye in eyes.tolist()]
    cameras = [Camera((8, 8), lens, trajectory=look_at(*place)) for place in places]
    centre, scale = focus(cameras)
    np.testing.assert_allclose(centre, target, atol=1e-5)
    assert scale == pytest.approx(0.5, abs=1e-5)
