"""Curves of a fit are those of its figures."""

import json

import numpy as np
import pytest

from gaussray.report import reconstruction
from gaussray.report.run import duration, file_size, how_to_reproduce, json_lines


@pytest.fixture
def out(tmp_path):
    """Two stages of which the second was gone on with, and a line that was cut off."""
    rows = [("coarse", 10, 30.0), ("coarse", 20, 31.0), ("fine", 10, 60.0), ("fine", 20, 62.0)]
    rows += [("fine", 30, 0.5), ("fine", 40, 2.5)]
    told = [
        {"stage": stage, "step": step, "seconds": seconds, "l1": 0.1, "mse": 0.01, "psnr": 20.0}
        for stage, step, seconds in rows
    ]
    text = "".join(json.dumps(line) + "\n" for line in told)
    (tmp_path / "metrics.jsonl").write_text(text + '{"stage": "fi')
    return tmp_path


def test_steps_are_counted_through_the_stages(out):
    told = json_lines(out / "metrics.jsonl")
    step, borders = reconstruction.step_numbers(told)
    assert step.tolist() == [10, 20, 30, 40, 50, 60]
    assert borders == [(0.0, "coarse"), (20.0, "fine")]


def test_the_pace_leaves_out_the_change_of_stages_and_interruptions(out):
    told = json_lines(out / "metrics.jsonl")
    pace, at = reconstruction.milliseconds_per_step(told, reconstruction.step_numbers(told)[0])
    np.testing.assert_allclose(pace, [100, 200, 200])
    assert at.tolist() == [20, 40, 60]


def test_what_was_tried_is_listed_with_its_loss():
    step = {"step": "<b>faint</b>", "taken": True, "loss": 0.01}
    facts = {"gaussians": 12000, "psnr": 25.0}
    section = reconstruction.pruning({"before": facts, "after": facts, "steps": [step]})
    text = "".join(map(str, section.body))
    assert "12,000" in text and "0.0100" in text and "&lt;b&gt;faint" in text
    assert reconstruction.pruning({"precision": "full"}) is None


def test_the_headline_is_what_was_measured_after_the_fit(out):
    assert reconstruction.training_psnr(out) == json_lines(out / "metrics.jsonl")[-1]["psnr"]
    measured = out / "requirement.json"
    measured.write_text('{"psnr": 30.5, "one_color": 12.0}')
    assert reconstruction.training_psnr(out) == 30.5
    parts = [{"before": {"psnr": 9.0}, "after": {"psnr": 30.0}}, {"after": {"psnr": 31.0}}]
    measured.write_text(json.dumps({"segments": parts}))
    assert reconstruction.training_psnr(out) == 30.5


def test_a_run_that_left_little_has_what_there_is(tmp_path):
    assert (
        reconstruction.training_curves(tmp_path) is None
        and reconstruction.training_psnr(tmp_path) is None
    )
    assert "There is no config.yaml." in "".join(map(str, how_to_reproduce(tmp_path, []).body))


def test_times_and_sizes_are_said_as_people_say_them():
    assert (duration(3.14), duration(75.0), duration(7320.0)) == (
        "3.1 s",
        "1 min 15 s",
        "2 h 2 min",
    )
    assert (file_size(299_000.0), file_size(2_500.0)) == (("0.299", "MB"), ("2.5", "kB"))
