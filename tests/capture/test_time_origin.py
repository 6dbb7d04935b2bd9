"""Timestamps that 32 bits do not tell apart are counted from the first."""

import json
import warnings

import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.open import open_capture
from gaussray.dataset.images import write_image
from gaussray.dataset.manifest import write_manifest


TIMES = (0.0, 0.04, 0.08, 0.2)
# Seconds since 1970, of a day in 2024. Python's numbers there are 2.4e-7 apart.
EPOCH, FLOOR = 1732700000.25, 1e-6


def written(folder, first, edit=lambda frame: frame):
    """A capture of black pictures whose times begin at `first`, and an effect with the same."""
    records = toy.records(TIMES)
    for record in records:
        write_image(folder / record.file_path, np.zeros((toy.SIZE, toy.SIZE, 3), np.float32))
    path = folder / "transforms.json"
    write_manifest(path, records, extra={"time_unit": "seconds"})
    content = json.loads(path.read_text())
    for frame in content["frames"]:
        frame["time"] += first
        edit(frame)
    path.write_text(json.dumps(content))
    late = content | {"effect": "late", "frames": content["frames"][-1:]}
    (folder / "late.json").write_text(json.dumps(late))
    return folder


def test_seconds_since_1970_are_counted_from_the_first(tmp_path):
    with pytest.warns(CaptureWarning, match="begin at 1732700000.* counted from the first"):
        capture = open_capture(written(tmp_path, EPOCH), dtype=jnp.float32)
    for views in (capture.views, capture.effects["late"]):
        for view in views:
            np.testing.assert_allclose(view.camera.time, view.time, atol=FLOOR)
    assert capture.time_range == pytest.approx((0.0, 0.2), abs=FLOOR)
    found = sorted({view.time for view in capture.views})
    np.testing.assert_allclose(found, TIMES, atol=FLOOR)
    assert capture.effects["late"][0].time == pytest.approx(0.2, abs=FLOOR)


@pytest.mark.parametrize("first", [0.0, 3.0, -0.1])
def test_times_that_can_be_told_apart_stay(tmp_path, first):
    with warnings.catch_warnings():
        warnings.simplefilter("error", CaptureWarning)
        capture = open_capture(written(tmp_path, first), dtype=jnp.float32)
    assert capture.time_range == pytest.approx((first, first + 0.2))


def test_times_that_poses_follow_are_not_changed(tmp_path):
    def edit(frame):
        pose = frame.pop("transform_matrix")
        begin, end = EPOCH - 1000, EPOCH + 1000
        frame["trajectory"] = [
            {"time": begin, "transform_matrix": pose},
            {"time": end, "transform_matrix": pose},
        ]

    with pytest.raises(CaptureError, match="Subtract the first time"):
        open_capture(written(tmp_path, EPOCH, edit), dtype=jnp.float32)
