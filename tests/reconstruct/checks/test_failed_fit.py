"""A fit that is worth less than one colour per camera ends in an error, and nothing is written."""

import dataclasses
import shutil

import jax
import numpy as np
import pytest
import toy

from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.formats.paired import read_capture
from gaussray.cli.main import main
from gaussray.dataset.images import write_image
from gaussray.reconstruct import pipeline as recipe
from gaussray.reconstruct.checks.failed_fit import (
    FailedFit,
    demand_detail,
    demand_success,
    warn_of_one_place,
)
from gaussray.reconstruct.data.pictures import footage
from gaussray.reconstruct.simplify.tile_views import TrainingViews, one_color_psnr, tile_views


pytestmark = pytest.mark.usefixtures("known_sizes")

TRACE = toy.SHORT.trace
# Single precision sums over some thousand pixels.
CLOSE = 1e-3


@pytest.fixture(scope="module")
def folder(tmp_path_factory, known_sizes):
    return toy.write_capture(tmp_path_factory.mktemp("capture"), toy.scene())


@pytest.fixture(scope="module")
def capture(folder):
    return read_capture(folder)


def nothing():
    """A scene without Gaussians."""
    scene = toy.scene()
    static, moving = (jax.tree.map(lambda x: x[:0], part) for part in (scene.static, scene.moving))
    return dataclasses.replace(scene, static=static, moving=moving)


def judged(capture, psnr, one_color, scene=None, start="auto"):
    report = {"psnr": psnr, "one_color": one_color}
    demand_success(toy.scene() if scene is None else scene, report, capture, start)


def test_a_fit_above_one_color_per_camera_is_no_failure(capture):
    judged(capture, 12.0, 11.9)
    judged(capture, 12.0, 12.0)


def test_a_fit_below_one_color_per_camera_fails_with_both_scores_and_the_likely_causes(capture):
    told = r"10\.3 dB .* one colour per camera has 12\.4 dB.* no points.*background.*poses"
    with pytest.raises(FailedFit, match=told):
        judged(dataclasses.replace(capture, points=None), 10.3, 12.4)


def test_random_points_are_the_cause_only_where_the_fit_began_with_them(capture):
    bare = dataclasses.replace(capture, points=None)
    told = {
        "random": "random points",
        "given": "random points",
        "auto": "stereo",
        "stereo": "stereo",
    }
    for start, cause in told.items():
        with pytest.raises(FailedFit) as failure:
            judged(bare, 10.3, 12.4, start=start)
        assert cause in str(failure.value)
        assert ("random points" in str(failure.value)) == (cause == "random points")


def test_a_scene_without_gaussians_fails(capture):
    with pytest.raises(FailedFit, match="need none of its Gaussians"):
        judged(capture, 120.0, 120.0, nothing())


def test_points_are_no_cause_where_the_capture_has_some(capture):
    with pytest.raises(FailedFit) as failure:
        judged(capture, 10.3, 12.4)
    assert "no points" not in str(failure.value)


def test_one_color_per_camera_scores_the_variance_of_its_pictures(folder):
    views = [view for view in read_capture(folder).views if view.split == "train"]
    seen = footage(views, side=TRACE.bundle)
    tiles = seen.pixel.shape[1]
    measured = tile_views(
        TrainingViews(seen, seen.camera), tiles=10**6, instants=99, weigh=1, seed=0
    ).measured
    assert all(
        len(view.truth) == len(set(seen.name)) * tiles * TRACE.bundle**2 for view in measured
    )
    square = []
    for name in np.unique(seen.name):
        pixel = seen.pixel[seen.name == name].reshape(-1, 3) / 255
        square.append(np.mean((pixel - pixel.mean(axis=0)) ** 2))
    assert one_color_psnr(measured) == pytest.approx(-10 * np.log10(np.mean(square)), abs=CLOSE)


def test_the_command_fails_and_leaves_the_scene_that_is_there(
    folder, tmp_path, monkeypatch, capsys
):
    report = {"psnr": 9.0, "one_color": 14.0, "precision": "full"}
    monkeypatch.setattr(recipe, "pruned_segment", lambda *_: (nothing(), report))
    monkeypatch.setattr(recipe, "fitted_state", lambda _, state, progress: (state, progress))
    # There is no state to keep.
    monkeypatch.setattr(recipe.RunLog, "save", lambda *_: None)
    (tmp_path / "scene.npz").write_bytes(b"an earlier scene")
    words = ["fit.coarse=1", "fit.fine=1", "fit.tiles=4", "fit.block=1", "fit.start=given"]
    with pytest.raises(SystemExit) as end:
        main(["reconstruct", f"capture.path={folder}", f"out={tmp_path}", "report=false", *words])
    assert end.value.code == 2
    message = capsys.readouterr().err
    assert "the fit failed: 9.0 dB" in message and "Traceback" not in message
    assert (tmp_path / "scene.npz").read_bytes() == b"an earlier scene"


def test_pictures_of_a_single_color_each_are_refused(capture):
    seen = dataclasses.replace(footage(capture.views, side=8), mask=None)
    demand_detail(seen)
    flat = np.broadcast_to(seen.pixel[:, :1, :1], seen.pixel.shape).copy()
    with pytest.raises(
        CaptureError, match=f"each of the {len(flat)} training pictures shows a sin"
    ):
        demand_detail(dataclasses.replace(seen, pixel=flat))
    flat[-1, -1, -1, 2] ^= 1
    demand_detail(dataclasses.replace(seen, pixel=flat))


def test_pixels_that_are_masked_show_nothing(capture):
    seen = footage(capture.views, side=8)
    flat = np.broadcast_to(seen.pixel[:, :1, :1], seen.pixel.shape).copy()
    flat[:, :, :8] = 255 - flat[:, :, :8]
    masked = np.full((*flat.shape[:2], flat.shape[2] // 8), 255, np.uint8)
    demand_detail(dataclasses.replace(seen, pixel=flat, mask=masked))
    masked[:, :, 0] = 0
    with pytest.raises(CaptureError, match="single colour"):
        demand_detail(dataclasses.replace(seen, pixel=flat, mask=masked))


def test_a_single_color_is_refused_before_the_fit(folder, tmp_path):
    copied = tmp_path / "capture"
    shutil.copytree(folder, copied)
    for path in copied.rglob("*.png"):
        write_image(path, np.full((toy.SIZE, toy.SIZE, 3), 0.25))
    words = ["reconstruct", f"capture.path={copied}", f"out={tmp_path / 'run'}", "quiet=true"]
    with pytest.raises(SystemExit, match="2"):
        main(words)
    assert not (tmp_path / "run/scene.npz").exists()


def test_pictures_of_one_place_without_points_are_warned_of(capture):
    one = [view for view in capture.views if view.camera_name == toy.CAMERAS[0]]
    bare = dataclasses.replace(capture, points=None)
    warn_of_one_place(bare)
    warn_of_one_place(dataclasses.replace(capture, views=one))
    assert capture.points is not None
    with pytest.warns(CaptureWarning, match="taken from one place"):
        warn_of_one_place(dataclasses.replace(bare, views=one))
    with pytest.warns(CaptureWarning, match="one training picture"):
        warn_of_one_place(dataclasses.replace(bare, views=one[:1]))
