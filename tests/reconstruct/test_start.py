"""The state before the first step."""

from dataclasses import replace

import equinox as eqx
import numpy as np
import pytest
import toy

from gaussray.capture.formats.paired import read_capture
from gaussray.dataset.images import write_image
from gaussray.reconstruct.log import RunLog
from gaussray.reconstruct.optimize.rows import occupied, take_rows
from gaussray.reconstruct.run_progress import RunProgress
from gaussray.reconstruct.segment_fit import pruned_segment
from gaussray.reconstruct.session import Session
from gaussray.reconstruct.start import initial_state, rows_beside_transients
from gaussray.scene.gaussians import constrain


@pytest.mark.parametrize(
    ("count", "budget", "share", "rows"),
    [
        # Few Gaussians that move may become many; many that rest are not expected to.
        (5_000, 200_000, 0.0, 10_000),
        (5_000, 200_000, 0.25, 50_000),
        (65_000, 200_000, 0.25, 130_000),
        (5_000, 200_000, 1.0, 200_000),
        # There is no row that the budget could not fill, and none for what there is none of.
        (10_000, 15_000, 0.0, 15_000),
        (0, 200_000, 1.0, 0),
    ],
)
def test_gaussians_beside_transient_ones_begin_with_room(count, budget, share, rows):
    assert rows_beside_transients(count, budget, share=share) == rows


@pytest.fixture
def cut_out(tmp_path):
    """A session on pictures of one time whose masks show what is about the middle."""
    capture = read_capture(toy.write_capture(tmp_path / "in", toy.scene(speed=0), times=(0.0,)))
    for i, view in enumerate(capture.views):
        picture, edge = np.zeros((toy.SIZE, toy.SIZE, 4), np.uint8), 5 if i % 4 else 3
        picture[edge:-edge, edge:-edge] = 200, 100, 50, 255
        write_image(view.image, picture)
    views = [replace(view, background="mask") for view in capture.views]
    log = RunLog(tmp_path / "out", resume=False, interval=0.0)
    options = replace(toy.SHORT, fit=replace(toy.SHORT.fit, points=200, surround=1.0))
    return Session(replace(capture, views=views), log, options, True)


def test_nothing_starts_or_stays_outside_what_masks_show(cut_out):
    points = cut_out.initial_points.position
    outside = cut_out.outside(points)
    assert outside.any()
    state, progress = initial_state(cut_out, RunProgress())
    kept = state.parameters.static
    static = constrain(take_rows(kept, np.flatnonzero(occupied(kept))))
    assert static.count and not cut_out.outside(np.asarray(static.mean)).any()
    mean = kept.mean.at[0].set(points[outside][0])
    drifted = eqx.tree_at(lambda s: s.parameters.static.mean, state, mean)
    scene, _ = pruned_segment(cut_out, drifted, progress, 1)
    assert scene.static.count == static.count - 1
