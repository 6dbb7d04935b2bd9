"""Run folders and scenes of the version before resume and load (previous/README.md)."""

import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import toy

from gaussray.capture.formats.paired import read_capture
from gaussray.reconstruct.initialize.body_tracking import TrackOptions
from gaussray.reconstruct.log import RunLog
from gaussray.reconstruct.optimize.density import DensityOptions
from gaussray.reconstruct.optimize.learning_rates import OptimizerOptions
from gaussray.reconstruct.options import FitOptions, ReconstructOptions
from gaussray.reconstruct.pipeline import reconstruct
from gaussray.render.options import RenderOptions
from gaussray.render.renderer import Renderer
from gaussray.scene.store import load_scene


pytestmark = pytest.mark.ci


PREVIOUS = Path(__file__).parent / "previous"
OPTIONS = ReconstructOptions(
    fit=FitOptions(
        auto=False,
        coarse=20,
        fine=60,
        tiles=4,
        block=10,
        points=27,
        error_share=0.5,
        checkpoint=0.0,
        refine=("exposure",),
    ),
    track=TrackOptions(poses=8, points=4, elite=2, rounds=1, blur=(0.5,)),
    # What the previous version's rate of means, 1e-3 extents, is in pixels of this capture.
    optimizer=OptimizerOptions(mean=6.4e-3, decay=0.1),
    density=DensityOptions(interval=10, threshold=1e-5),
    field=toy.SHORT.field,
    trace=toy.SHORT.trace,
    prune=toy.SHORT.prune,
)
RUNS = {
    "single": OPTIONS,
    "segmented": dataclasses.replace(
        OPTIONS, fit=dataclasses.replace(OPTIONS.fit, segment=2, moving_threshold=0.4)
    ),
}
# Linear light of the finished scenes, against the previous version's own: nearly everywhere, and
# anywhere. In arrays they are equal bit by bit on the machine that made the files. Other processors
# and machine code sum up in another order, and the steps that are left amplify that.
LIGHT, LIGHT_MOST, NEARLY = 0.02, 0.1, 0.998
# Mean distance from what was filmed that the few steps leave; black would be 0.3 away.
LEARNT = 0.1
TIMES = (0.0, 0.25, 0.5, 1.0)
SECOND_SEGMENT = 0.5  # where the second of two segments begins


def copied(name, folder):
    """The run folder, to be written to, and what a finished run of the previous version left."""
    shutil.copytree(PREVIOUS / name, folder)
    return folder, load_scene((folder / "finished.npz").rename(folder.parent / "finished.npz"))


def pictures(scene):
    renderer = Renderer(scene, options=RenderOptions(samples=1), trace=toy.TRACE)
    return np.stack([renderer(toy.camera(0.15, time)).color for time in TIMES])


@pytest.mark.parametrize("name", RUNS)
def test_a_run_of_the_previous_version_resumes_and_ends_as_it_would_have_ended(name, tmp_path):
    out, finished = copied(name, tmp_path / "run")
    capture = read_capture(PREVIOUS / "capture")
    before = len((out / "metrics.jsonl").read_text().splitlines())
    scene = reconstruct(capture, out, options=RUNS[name], resume=True, quiet=True)
    lines = [json.loads(line) for line in (out / "metrics.jsonl").read_text().splitlines()]
    # The blocks before the saved state are kept, all others are run.
    assert len(lines) == (8 if name == "single" else 14) and before > 4
    assert lines[-1]["stage"] == "fine" and lines[-1]["step"] == OPTIONS.fit.fine
    light = pictures(scene)
    # A second segment finds its bodies and starts with this version, whose search is another: what
    # the previous version had learnt by then, the first segment, is what has to be the same.
    same = TIMES if name == "single" else [time for time in TIMES if time < SECOND_SEGMENT]
    difference = np.abs(light - pictures(finished))[: len(same)]
    assert np.quantile(difference, NEARLY) < LIGHT and difference.max() < LIGHT_MOST
    assert np.abs(light - pictures(toy.scene())).mean() < LEARNT


def test_what_the_previous_version_noted_is_read(tmp_path):
    out, _ = copied("single", tmp_path / "run")
    state, progress = RunLog(out, resume=True, interval=1.0).resumed()
    assert progress.stage == "fine" and int(state.step) == 20
    assert (progress.segment, progress.segments) == (1, 1)
    assert (progress.initial, progress.limit, progress.most) == ((23, 4), (40, 5), 46)
    assert progress.sizes is not None and progress.sizes.sizes == (64, 320, 128)
    assert progress.tile_errors is not None and progress.tile_errors.mean.shape == (3, 4)
    assert state.static_statistic.seen.shape == state.parameters.static.logit_opacity.shape == (40,)
    out, _ = copied("segmented", tmp_path / "two" / "run")
    state, progress = RunLog(out, resume=True, interval=1.0).resumed()
    assert progress.stage == "begin" and (progress.segment, progress.segments) == (2, 2)
    assert progress.bodies is not None and progress.bodies.pivot.shape == (1, 3)


def test_a_scene_of_the_previous_version_shows_what_was_filmed():
    capture = read_capture(PREVIOUS / "capture")
    assert capture.points is not None
    light = pictures(load_scene(PREVIOUS / "single" / "finished.npz"))
    truth = pictures(toy.scene())
    assert np.abs(light - truth).mean() < LEARNT < np.abs(truth).mean()
