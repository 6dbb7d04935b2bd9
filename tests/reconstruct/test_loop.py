"""How many steps a stage takes, and what is said where its time is too short."""

from types import SimpleNamespace

import numpy as np
import pytest

from gaussray.reconstruct import step_plan
from gaussray.reconstruct.loop import planned_steps, short_time_sentence
from gaussray.reconstruct.options import FitOptions, ReconstructOptions
from gaussray.reconstruct.run_progress import RunProgress, StageSchedule
from gaussray.reconstruct.session import Session
from gaussray.reconstruct.step_plan import FEWEST_STEPS, FEWEST_STILL_STEPS, TimedPlan


def sentence(minutes, share, stage="coarse", before=0.0):
    plan = TimedPlan(60 * minutes * share, 50)
    plan.seconds_of_fewest, plan.schedule = 66.0, StageSchedule(600)
    return short_time_sentence(minutes, plan, stage, before)


def test_a_stage_that_gets_a_share_of_the_time_says_so():
    assert sentence(1.5, 0.25) == (
        "fit.minutes=1.5 is too short: the coarse stage gets 0.38 minutes of them, and takes about "
        "1.1 minutes for 600 steps, its fewest. fit.minutes=4.4 has time for them."
    )


@pytest.mark.parametrize(("before", "enough"), [(4.4, "4.4"), (1.0, "1.5")])
def test_the_second_stage_names_the_time_that_both_need(before, enough):
    told = sentence(1.0, 0.75, "fine", before)
    assert told.startswith("fit.minutes=1 is too short: the fine stage gets 0.75 minutes of them")
    assert told.endswith(f"fit.minutes={enough} has time for those of both stages.")


def test_a_stage_that_gets_all_of_the_time_says_nothing_of_shares():
    assert sentence(0.5, 1.0) == (
        "fit.minutes=0.5 is too short: this stage takes about 1.1 minutes for 600 steps, its "
        "fewest. fit.minutes=1.1 has time for them."
    )


def test_short_shares_are_told_apart():
    assert "gets 0.08 minutes of them, and takes about 1.1 minutes" in sentence(0.32, 0.25)
    assert "gets 120 minutes of them" in sentence(480.0, 0.25)


def test_what_stands_still_gets_steps_enough_before_all_else_counts_as_motion(monkeypatch):
    def steps(stage, times=30, still_first=True):
        session = object.__new__(Session)
        session.options = ReconstructOptions(fit=FitOptions(minutes=0.001))
        session.times, session.still_first = np.arange(times), still_first
        plan, now = planned_steps(session, RunProgress(stage=stage)), SimpleNamespace(value=100.0)
        monkeypatch.setattr(step_plan.time, "monotonic", lambda: now.value)
        for done in range(50, 350, 50):
            # A second for each step.
            now.value += 50
            plan.after_block(done)
        return plan.steps, plan.seconds_of_fewest

    assert FEWEST_STILL_STEPS > FEWEST_STEPS
    assert steps("coarse") == (FEWEST_STILL_STEPS, pytest.approx(FEWEST_STILL_STEPS))
    assert steps("fine") == (FEWEST_STEPS, pytest.approx(FEWEST_STEPS))
    # Photographs of one time have one stage.
    assert steps("coarse", times=1, still_first=False) == (
        FEWEST_STEPS,
        pytest.approx(FEWEST_STEPS),
    )
