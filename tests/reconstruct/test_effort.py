"""fit=auto: what is chosen follows device and capture, and what is set stays."""

from pathlib import Path
from types import SimpleNamespace

import pytest
import toy

from gaussray.capture.formats.paired import Capture, View
from gaussray.reconstruct import step_plan
from gaussray.reconstruct.effort import Machine, effort
from gaussray.reconstruct.optimize.density import DensityOptions
from gaussray.reconstruct.options import FitOptions, ReconstructOptions
from gaussray.reconstruct.run_progress import RunProgress, progress_from_json, progress_to_json
from gaussray.reconstruct.step_plan import StepPlan, TimedPlan
from gaussray.tracer.trace import TraceOptions


CPU, GPU = Machine(gpu=False), Machine(gpu=True)
AUTO = ReconstructOptions(fit=FitOptions(auto=True))


def capture(count=50, width=270, height=480, times=(0.0,)):
    """So many training pictures of this size at each time; none is opened."""
    camera, path = toy.camera(0.0, 0.0, width, height), Path("picture.png")
    views = [
        View(camera, path, None, None, "a", "train", time, "pinhole", None, "srgb")
        for time in times
        for _ in range(count)
    ]
    return Capture(Path("folder"), views, {}, None, (min(times), max(times)), "normalised")


def test_without_auto_nothing_is_chosen():
    options = ReconstructOptions()
    assert effort(capture(), options, GPU)[1:] == (options, "")


@pytest.mark.parametrize("machine", [CPU, GPU])
def test_photographs_of_one_time_get_relocation_under_a_budget_and_a_time(machine):
    chosen = effort(capture(), AUTO, machine)
    fit, density = chosen.options.fit, chosen.options.density
    assert density.relocates and density.gaussians == fit.points
    assert fit.minutes >= machine.minutes and fit.tile_side == 32
    assert f"{density.gaussians:,} Gaussians" in chosen.sentence
    assert f"{fit.minutes:.0f} minutes" in chosen.sentence


def test_larger_captures_get_more_gaussians_and_more_time():
    small, large = (effort(capture(n), AUTO, GPU).options for n in (50, 800))
    assert large.density.gaussians > small.density.gaussians
    assert 2 * small.fit.minutes < large.fit.minutes <= 4 * GPU.minutes


def test_a_gpu_gets_more_than_a_cpu():
    cpu, gpu = (effort(capture(), AUTO, machine).options for machine in (CPU, GPU))
    assert gpu.density.gaussians > cpu.density.gaussians
    assert gpu.fit.tiles > cpu.fit.tiles and gpu.fit.degree > cpu.fit.degree


def test_what_is_set_stays_set():
    options = ReconstructOptions(
        fit=FitOptions(auto=True, degree=2, minutes=7.0), density=DensityOptions(gaussians=123)
    )
    chosen = effort(capture(), options, GPU).options
    assert (chosen.fit.degree, chosen.fit.minutes) == (2, 7.0)
    assert chosen.density.gaussians == 123 and chosen.density.relocates
    # Rays are followed further than by default, unless that is set.
    assert chosen.trace.transmittance_min == 1e-3
    exact = ReconstructOptions(fit=AUTO.fit, trace=TraceOptions(levels=0, transmittance_min=0.0))
    assert effort(capture(), exact, GPU).options.trace == exact.trace


def test_given_steps_are_done_however_long_they_take():
    options = ReconstructOptions(fit=FitOptions(auto=True, coarse=10, fine=20))
    chosen = effort(capture(), options, GPU)
    assert (chosen.options.fit.minutes, chosen.options.fit.coarse) == (0, 10)
    assert "10 + 20 steps" in chosen.sentence


def test_what_moves_keeps_the_defaults_on_a_cpu_and_grows_on_a_gpu():
    moving = capture(times=(0.0, 1.0))
    on_cpu, on_gpu = (effort(moving, AUTO, machine).options for machine in (CPU, GPU))
    assert on_cpu == AUTO
    assert on_gpu.density.interval and on_gpu.fit.fine > AUTO.fit.fine
    assert not on_gpu.fit.minutes and not on_gpu.density.relocates


def test_a_fixed_plan_never_changes():
    plan = StepPlan(40)
    assert not any(plan.after_block(done) for done in range(10, 50, 10))
    assert plan.steps == plan.most == 40


def timed(monkeypatch, seconds, block=10, pace=0.5, until=2000):
    """The steps of a plan whose clock goes by `pace` a step, and when its blocks end."""
    now = SimpleNamespace(value=100.0)
    monkeypatch.setattr(step_plan.time, "monotonic", lambda: now.value)
    plan, done = TimedPlan(100.0 + seconds, block), 0
    while done < plan.steps and done < until:
        # The first block waits for the compiler.
        now.value += pace * block + (30 if not done else 0)
        done += block
        plan.after_block(done)
    return plan, done, now.value - 100.0


def test_a_timed_plan_ends_in_time(monkeypatch):
    plan, done, spent = timed(monkeypatch, seconds=300.0)
    assert done == plan.steps == 540
    assert 295 <= spent <= 300


def test_a_timed_plan_that_has_no_time_ends_once_the_pace_is_known(monkeypatch):
    plan, done, _ = timed(monkeypatch, seconds=1.0)
    assert done == plan.steps == 60


def test_a_resumed_run_keeps_the_plan():
    plan = TimedPlan(0.0, 10)
    plan.steps = 540
    noted = plan.noted(RunProgress())
    assert progress_from_json(progress_to_json(noted), None).planned == 540
    with pytest.raises(ValueError, match="planned"):
        progress_from_json(progress_to_json(noted) | {"planned": "many"}, None)
