"""fit=auto: what is chosen follows device and capture, and what is set stays."""

import json
import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.capture.capture import Capture, View
from gaussray.capture.points import Points
from gaussray.reconstruct import step_plan
from gaussray.reconstruct.auto.choice import auto_choice
from gaussray.reconstruct.auto.machine import Machine
from gaussray.reconstruct.data.held_out_tiles import (
    held_out_batches,
    held_out_tiles,
    trial_tiles,
)
from gaussray.reconstruct.data.pictures import Footage
from gaussray.reconstruct.initialize.body_tracking import TrackOptions
from gaussray.reconstruct.optimize.density import DensityOptions
from gaussray.reconstruct.optimize.learning_rates import OptimizerOptions
from gaussray.reconstruct.optimize.loss import LossOptions
from gaussray.reconstruct.options import FitOptions, ReconstructOptions
from gaussray.reconstruct.run_progress import (
    RunProgress,
    StageSchedule,
    progress_from_json,
    progress_to_json,
)
from gaussray.reconstruct.step import step_schedule
from gaussray.reconstruct.step_plan import Plateau, StepPlan, TimedPlan
from gaussray.tracer.options import TraceOptions


CPU, GPU = Machine(gpu=False), Machine(gpu=True)
AUTO = ReconstructOptions()


def capture(count=50, width=270, height=480, times=(0.0,)):
    """So many training pictures of this size at each time; a file is there, and is not opened."""
    camera, path = toy.camera(0.0, 0.0, width, height), Path(__file__)
    views = [
        View(camera, path, None, None, "a", "train", time, "pinhole", None, "srgb")
        for time in times
        for _ in range(count)
    ]
    return Capture(Path("folder"), views, {}, None, (min(times), max(times)), "normalised")


def test_without_auto_nothing_is_chosen():
    options = ReconstructOptions(fit=FitOptions(auto=False))
    assert auto_choice(capture(), options, GPU)[1:] == (options, "", (), 1.0)


@pytest.mark.parametrize("machine", [CPU, GPU])
def test_photographs_of_one_time_get_relocation_under_a_budget_and_a_time(machine):
    chosen = auto_choice(capture(), AUTO, machine)
    fit, density = chosen.options.fit, chosen.options.density
    assert density.relocates and density.gaussians > fit.points
    assert fit.minutes >= machine.minutes and fit.tile_side == 32
    assert f"{density.gaussians:,} Gaussians" in chosen.sentence
    assert f", about {fit.minutes:.2g} minutes of steps (fit.minutes); reading" in chosen.sentence


@pytest.mark.parametrize("still", [True, False])
def test_rates_follow_the_machine_and_what_is_set_stays(still):
    taken = capture(times=(0.0,) if still else (0.0, 1.0))
    options = ReconstructOptions(optimizer=OptimizerOptions(mean=0.1))
    for machine in (CPU, GPU):
        chosen = auto_choice(taken, options, machine).options.optimizer
        assert chosen == replace(machine.rates(still=still), mean=0.1)
    # A step of a CPU draws fewer tiles, of stills fewest.
    assert GPU.rates(still=still).color < CPU.rates(still=False).color < CPU.rates(still=True).color


def test_larger_captures_get_more_gaussians_and_more_time():
    small, large = (auto_choice(capture(n), AUTO, GPU).options for n in (50, 800))
    assert large.density.gaussians > small.density.gaussians
    assert 2 * small.fit.minutes < large.fit.minutes <= 4 * GPU.minutes


@pytest.mark.parametrize("still", [True, False])
def test_pictures_are_scaled_to_what_a_cpu_has_the_time_for(still):
    taken = capture(count=32, width=1000, height=1000, times=(0.0,) if still else (0.0, 1.0))
    views = auto_choice(taken, AUTO, CPU).capture.views
    total = sum(view.width * view.height for view in views)
    most = CPU.most_pixels("none" if still else "transient")
    assert total == pytest.approx(most, rel=0.01)
    assert auto_choice(taken, AUTO, GPU).capture is taken


def test_a_gpu_gets_more_than_a_cpu():
    cpu, gpu = (auto_choice(capture(), AUTO, machine).options for machine in (CPU, GPU))
    assert gpu.density.gaussians > cpu.density.gaussians
    assert gpu.fit.tiles > cpu.fit.tiles and gpu.fit.degree > cpu.fit.degree


@pytest.mark.parametrize("times", [(0.0,), (0.0, 1.0)])
def test_each_gpu_gets_as_many_rays_as_one_alone(times):
    one, four = (auto_choice(capture(times=times), AUTO, Machine(True, n)).options for n in (1, 4))
    assert four.fit.tiles == 4 * one.fit.tiles
    # The noise of a mean of four times as many gradients is half as large.
    assert four.optimizer.mean == pytest.approx(2 * one.optimizer.mean)
    assert four.optimizer.opacity == one.optimizer.opacity
    own = ReconstructOptions(fit=FitOptions(tiles=48))
    assert (
        auto_choice(capture(times=times), own, Machine(True, 4)).options.optimizer == one.optimizer
    )


def test_what_is_set_stays_set():
    options = ReconstructOptions(
        fit=FitOptions(degree=2, minutes=7.0), density=DensityOptions(gaussians=123)
    )
    chosen = auto_choice(capture(), options, GPU).options
    assert (chosen.fit.degree, chosen.fit.minutes) == (2, 7.0)
    assert chosen.density.gaussians == 123 and chosen.density.relocates
    # Rays are followed further than by default, unless that is set.
    assert chosen.trace.transmittance_min == 1e-3
    exact = ReconstructOptions(fit=AUTO.fit, trace=TraceOptions(levels=0, transmittance_min=0.0))
    traced = auto_choice(capture(), exact, GPU).options.trace
    assert traced == TraceOptions(k=chosen.trace.k, levels=0, transmittance_min=0.0)


def test_a_default_that_is_set_stays_too():
    kept = ("fit.degree", "fit.tiles", "density.kind", "fit.minutes", "fit.motion", "out")
    explicit = ReconstructOptions(explicit_keys=kept)
    moving = auto_choice(capture(times=(0.0, 1.0)), explicit, GPU).options
    assert moving.fit.motion != "auto"
    chosen = auto_choice(capture(), explicit, GPU).options
    assert chosen.fit.degree == 0 and chosen.fit.tiles == FitOptions().tiles
    assert chosen.density.kind == DensityOptions().kind and chosen.density.gaussians > 0
    # These say themselves that they are to be chosen.
    assert chosen.fit.minutes > 0
    # Steps that are set hold, whatever the time.
    steps = auto_choice(capture(), ReconstructOptions(explicit_keys=("fit.fine",)), GPU).options.fit
    assert (steps.minutes, steps.coarse, steps.fine) == (0, 300, 2500)


def test_given_steps_are_done_however_long_they_take():
    options = ReconstructOptions(fit=FitOptions(coarse=10, fine=20))
    chosen = auto_choice(capture(times=(0.0, 1.0)), options, GPU)
    assert (chosen.options.fit.minutes, chosen.options.fit.coarse) == (0, 10)
    assert "10 + 20 steps" in chosen.sentence


def test_a_static_capture_has_all_the_steps_in_one_stage():
    options = ReconstructOptions(fit=FitOptions(coarse=10, fine=2000))
    assert ", 2,010 steps." in auto_choice(capture(times=(0.0,)), options, GPU).sentence


def from_places(count, points=None):
    """Four times from so many cameras that stand still."""
    times = (0.0, 0.25, 0.5, 0.75)
    base = capture(count=count, times=times)
    views = [replace(v, camera_name=f"{i % count}") for i, v in enumerate(base.views)]
    return replace(base, views=views, points=points)


def from_two_places(points=None):
    """Four times from two cameras that stand still."""
    return from_places(2, points)


def test_rigid_bodies_keep_the_defaults_on_a_cpu_and_grow_on_a_gpu():
    wanted = ReconstructOptions(fit=FitOptions(motion="deformation"))
    many = Points(np.zeros((10_000, 3), np.float32), np.zeros((10_000, 3), np.float32))
    for points in (None, many):
        on_cpu, on_gpu = (
            auto_choice(from_two_places(points), wanted, m).options for m in (CPU, GPU)
        )
        assert on_cpu == wanted
        assert on_gpu.density.interval and on_gpu.fit.fine > AUTO.fit.fine
        assert not on_gpu.fit.minutes
        # On stereo's points, what stands still is fitted as without bodies.
        assert on_gpu.density.relocates == (on_gpu.loss.dssim > 0) == (points is None)


@pytest.mark.parametrize("still", [True, False])
def test_opacity_costs_more_where_few_viewpoints_show_a_scene(still):
    def chosen(places, machine=GPU, options=AUTO):
        taken = from_places(places)
        if still:
            taken = replace(taken, views=[v for v in taken.views if v.time == 0.0])
        return auto_choice(taken, options, machine).options.density

    def cost(*arguments, **options):
        return chosen(*arguments, **options).opacity_cost

    usual = cost(200)
    # In inverse proportion to the number of viewpoints, between the usual cost and a limit.
    assert cost(20) == pytest.approx(2 * cost(40)) and cost(20) > usual
    assert usual < cost(10) == cost(5) < 1
    # With fewer than five it is lower again; on a CPU it stays.
    assert usual < cost(4) == cost(2) < cost(5) and cost(10, CPU) == cost(200, CPU)
    # Transient Gaussians cost 1 at most.
    assert all(chosen(n).transient_cost * cost(n) <= 1 for n in (2, 4, 5, 10, 20, 200))
    own = replace(AUTO, density=DensityOptions(kind="relocate", opacity_cost=0.3))
    assert cost(10, options=own) == 0.3


def test_a_field_on_bodies_without_given_points_is_smooth_in_time():
    wanted = ReconstructOptions(fit=FitOptions(motion="deformation"))
    assert (
        auto_choice(from_places(9), wanted, GPU).options.loss.time_smoothness
        > LossOptions().time_smoothness
    )


@pytest.mark.parametrize("machine", [CPU, GPU])
def test_without_points_transient_gaussians_show_what_moves(machine):
    chosen = auto_choice(from_two_places(), AUTO, machine)
    fit = chosen.options.fit
    assert fit.motion == "transient" and fit.minutes >= machine.minutes and fit.tile_side == 32
    assert chosen.options.density.relocates
    assert "transient Gaussians (fit.motion)" in chosen.sentence


def test_a_gpu_tries_more_poses_unless_the_user_chose_some():
    wanted = ReconstructOptions(fit=FitOptions(motion="deformation"))
    taken = from_two_places(None)
    assert auto_choice(taken, wanted, GPU).options.track.poses > TrackOptions().poses
    own = replace(wanted, track=TrackOptions(poses=32))
    assert auto_choice(taken, own, GPU).options.track == own.track


@pytest.mark.parametrize(
    ("at_once", "motion"), [(1, "from_rest"), (2, "transient"), (5, "control_points")]
)
def test_cameras_that_move_get_transient_gaussians_if_two_see_each_time(at_once, motion):
    many = Points(np.zeros((10_000, 3), np.float32), np.zeros((10_000, 3), np.float32))
    base = capture(count=at_once, times=(0.0, 0.5, 1.0))
    # Every picture is of a viewpoint of its own.
    views = [replace(v, camera_name=f"{i}") for i, v in enumerate(base.views)]
    chosen = auto_choice(replace(base, views=views, points=many), AUTO, GPU)
    assert chosen.options.fit.motion == motion


@pytest.mark.parametrize("machine", [CPU, GPU])
@pytest.mark.parametrize("cameras", [1, 3])
def test_pictures_that_each_have_their_own_time_share_gaussians_on_control_points(cameras, machine):
    base = capture(count=1, times=tuple(np.linspace(0, 1, 12)))
    # One camera that jumps from place to place, or three that take turns.
    places = np.random.default_rng(0).permutation(12) if cameras == 1 else np.arange(12) % 3
    views = [
        replace(v, camera_name=f"{k}", camera=toy.camera(0.5 * k, v.time, 270, 480))
        for k, v in zip(places, base.views, strict=True)
    ]
    chosen = auto_choice(replace(base, views=views), AUTO, machine)
    fit = chosen.options.fit
    assert fit.motion == "from_rest" and "control points that begin at rest" in chosen.sentence
    assert fit.tile_side == 32 and chosen.options.density.relocates and fit.minutes > 0


def test_a_cost_of_opacity_that_is_set_is_known_to_be():
    own = replace(AUTO, density=replace(AUTO.density, opacity_cost=0.07))
    found = auto_choice(capture(), own, GPU).options
    assert found.density.opacity_cost == 0.07 and "density.opacity_cost" in found.explicit_keys
    assert "density.opacity_cost" not in auto_choice(capture(), AUTO, GPU).options.explicit_keys


@pytest.mark.parametrize("machine", [CPU, GPU])
def test_one_shot_of_a_rig_whose_cameras_are_triggered_one_after_another_is_still(machine):
    def motion(span, unit, names=6):
        base = capture(count=1, times=tuple(np.linspace(0, span, 6)))
        views = [
            replace(v, camera_name=f"{k % names}", camera=toy.camera(0.5 * k, v.time, 270, 480))
            for k, v in enumerate(base.views)
        ]
        chosen = auto_choice(replace(base, views=views, time_unit=unit), AUTO, machine)
        return chosen.options.fit.motion, "nothing moves" in chosen.sentence

    assert motion(0.042, "seconds") == ("none", True)
    # Later, in another unit, or by one camera on its way, pictures may show motion.
    for other in (motion(2.0, "seconds"), motion(0.042, "normalised"), motion(0.04, "seconds", 1)):
        assert other[0] != "none" and not other[1]


@pytest.mark.parametrize("machine", [CPU, GPU])
def test_transient_gaussians_show_what_a_camera_films_on_its_way(machine):
    base = capture(count=1, times=tuple(np.linspace(0, 1, 20)))
    angles = np.linspace(0, 0.5, 20)

    def motion(order):
        views = [
            replace(v, camera=toy.camera(angles[k], v.time, 270, 480))
            for k, v in zip(order, base.views, strict=True)
        ]
        return auto_choice(replace(base, views=views), AUTO, machine).options.fit.motion

    assert motion(range(20)) == "transient"
    # From places at random, each far from the one before.
    assert motion(np.random.default_rng(0).permutation(20)) == "from_rest"


@pytest.mark.parametrize("machine", [CPU, GPU])
def test_a_video_of_what_stands_still_is_fitted_like_photographs(machine):
    base = capture(count=1, times=tuple(np.linspace(0, 1, 20)))
    known = ReconstructOptions(fit=FitOptions(motion="none"))
    found = auto_choice(base, known, machine)
    photographs = [replace(view, time=0.0) for view in base.views]
    still = auto_choice(replace(base, views=photographs), AUTO, machine).options
    assert found.options == replace(still, fit=replace(still.fit, motion="none"))
    assert "nothing moves (fit.motion=none)" in found.sentence and not found.candidates
    assert not (found.options.fit.deforms or found.options.fit.transient)


def test_points_on_surfaces_let_rigid_bodies_be_found():
    many = Points(np.zeros((10_000, 3), np.float32), np.zeros((10_000, 3), np.float32))
    few = Points(many.position[:500], many.color[:500])
    # But things may be soft: a trial tells which is better.
    for machine, steps in ((CPU, 2500), (GPU, 16_000)):
        tried = auto_choice(from_two_places(many), AUTO, machine)
        assert tried.candidates == ("deformation", "transient") and tried.options.fit.fine == steps
        assert tried.options.fit.motion == "deformation"
        # But not before a fit that is shorter than that.
        short = ReconstructOptions(fit=FitOptions(fine=machine.trial_steps("deformation") - 1))
        chosen = auto_choice(from_two_places(many), short, machine)
        assert chosen.options.fit.motion == "deformation" and not chosen.candidates
    assert auto_choice(from_two_places(few), AUTO, GPU).options.fit.motion == "transient"
    wanted = ReconstructOptions(fit=FitOptions(motion="both"))
    chosen = auto_choice(from_two_places(many), wanted, GPU)
    assert chosen.options.fit.motion == "both" and not chosen.candidates
    wanted = ReconstructOptions(fit=FitOptions(motion="deformation"))
    chosen = auto_choice(from_two_places(few), wanted, GPU)
    assert chosen.options.fit.motion == "deformation" and chosen.options.density.relocates


@pytest.mark.parametrize(
    ("cameras", "start", "machine", "tried"),
    [(5, "auto", GPU, True), (5, "stereo", GPU, True), (4, "auto", GPU, False),
     (5, "random", GPU, False), (5, "given", GPU, False), (5, "auto", CPU, True),
     (4, "auto", CPU, False), (5, "random", CPU, False)],
)  # fmt: skip
def test_stereo_between_many_cameras_is_worth_a_trial(cameras, start, machine, tried):
    """Of rigid bodies beside control points on a GPU, of these beside transient ones on a CPU."""
    options = ReconstructOptions(fit=FitOptions(start=start))
    chosen = auto_choice(from_places(cameras), options, machine)
    candidates = (
        ("control_points", "deformation") if machine.gpu else ("transient", "control_points")
    )
    assert chosen.options.fit.motion == (candidates[0] if tried else "transient")
    assert chosen.options.density.relocates
    assert chosen.candidates == (candidates if tried else ())
    # A step with control points takes a CPU longer, so a trial takes fewer of them.
    steps = [machine.trial_steps(name) for name in candidates]
    assert steps[0] == steps[1] if machine.gpu else steps[0] > steps[1]
    # Given points change which is likelier.
    many = Points(np.zeros((10_000, 3), np.float32), np.zeros((10_000, 3), np.float32))
    given = auto_choice(from_places(cameras, many), ReconstructOptions(), machine)
    candidate = "control_points" if cameras >= 5 else "transient"
    candidate = candidate if machine.gpu else "transient"
    assert given.candidates == ("deformation", candidate)


def test_a_fixed_plan_never_changes():
    plan = StepPlan(StageSchedule(40))
    assert not any(plan.after_block(done) for done in range(10, 50, 10))
    assert plan.steps == plan.most == 40


def timed(monkeypatch, seconds, block=10, pace=0.5, until=2000, score=None, more=None):
    """The steps of a plan whose clock goes by `pace` a step, and when its blocks end. The blocks
    that end at the steps `more` take so many seconds more."""
    now = SimpleNamespace(value=100.0)
    monkeypatch.setattr(step_plan.time, "monotonic", lambda: now.value)
    plan, done = TimedPlan(seconds, block), 0
    while done < plan.steps and done < until:
        # The first block waits for the compiler.
        now.value += pace * block + (30 if not done else 0)
        done += block
        now.value += (more or {}).get(done, 0)
        plan.after_block(done, score and partial(score, done))
    return plan, done, now.value - 100.0


def test_a_timed_plan_ends_in_time(monkeypatch):
    plan, done, spent = timed(monkeypatch, seconds=300.0)
    # The first block, which waits for the compiler, does not count.
    assert done == plan.steps == 610
    assert 295 <= spent - 35 <= 300


def test_a_time_that_is_too_short_for_the_fewest_steps_is_told(monkeypatch):
    plan, done, _ = timed(monkeypatch, seconds=60.0)
    assert done == plan.steps == 600
    assert plan.seconds_of_fewest == pytest.approx(600 * 0.5)
    assert not timed(monkeypatch, seconds=310.0)[0].seconds_of_fewest


def test_time_in_which_a_compiler_works_does_not_count(monkeypatch):
    more = {100: 40, 110: 40, 250: 40}
    plan, done, spent = timed(monkeypatch, seconds=400.0, more=more)
    assert done == plan.steps == 810
    assert 395 <= spent - 35 - sum(more.values()) <= 400


def test_steps_that_get_slower_count(monkeypatch):
    """From step 200 on they take ten times as long: three blocks pass for a compiler's."""
    more = {done: 45 for done in range(200, 2000, 10)}
    plan, done, spent = timed(monkeypatch, seconds=4000.0, more=more)
    assert done == plan.steps < 1100
    assert 4000 <= spent - 35 <= 4000 + 3 * 50


def test_blocks_that_take_three_times_as_long_count(monkeypatch):
    plan, done, spent = timed(monkeypatch, seconds=400.0, more={100: 10, 110: 10, 250: 10})
    assert done == plan.steps == 750
    assert 395 <= spent - 35 <= 400


def test_a_plan_grows_where_steps_were_slow_for_a_while(monkeypatch):
    """They take three times as long, from before the middle of what is then planned to after it."""
    slow = {done: 10 for done in range(500, 810, 10)}
    plan, done, spent = timed(monkeypatch, seconds=1000.0, more=slow)
    assert done == plan.steps
    assert 990 <= spent - 35 <= 1000
    # Rates go on from what they were, to the end.
    assert 0 < plan.schedule.begin < done and plan.schedule.share > 0
    assert plan.schedule.share_at(done) == 1


def test_rates_never_rise_after_a_plan_has_grown(monkeypatch):
    """Steps are slow up to step 500, four times as fast from then on, for a long time."""
    shares, plans = [], []
    after = TimedPlan.after_block

    def watched(self, done, score=None):
        before, changed = self.schedule, after(self, done, score)
        if self.schedule.begin:
            shares.append(float(self.schedule.share_at(done)))
            assert self.schedule.steps >= before.steps and changed == (self.schedule != before)
        plans.append(self.seconds_of_fewest)
        return changed

    monkeypatch.setattr(TimedPlan, "after_block", watched)
    slow = {done: 15 for done in range(10, 510, 10)}
    plan, done, spent = timed(monkeypatch, seconds=1500.0, more=slow)
    assert done == plan.steps and 1490 <= spent - 50 <= 1500
    assert len(shares) > 10 and (np.diff(shares) > 0).all() and shares[-1] == 1
    # A plan of the fewest steps, which take too long, is not told so any more once it has grown.
    plan, *_ = timed(monkeypatch, seconds=1000.0, more={n: 15 for n in range(10, 320, 10)})
    assert plan.steps > 600 and max(plans) > 0 and plan.seconds_of_fewest == 0


def test_a_timed_plan_that_has_no_time_takes_the_fewest_steps(monkeypatch):
    plan, done, _ = timed(monkeypatch, seconds=1.0)
    assert done == plan.steps == 600


def test_a_plateau_begins_where_the_score_gained_nothing_for_a_fifth_of_the_steps():
    plateau = Plateau(patience=0.2, gain=0.05)
    scores = {100: 20.0, 200: 21.0, 220: 21.04, 240: 20.9, 251: 21.04}
    assert [plateau.reached(*pair) for pair in scores.items()] == [False] * 4 + [True]
    assert not plateau.reached(260, 21.06)
    # Looks far apart: one or two of them may be chance.
    rare = Plateau(patience=0.2, gain=0.05)
    assert not any(rare.reached(250 * k, score) for k, score in enumerate((20.0, 19.9, 19.8), 1))
    assert rare.reached(1000, 19.9)
    # What could not be measured ends nothing.
    assert not plateau.reached(400, math.nan) and not plateau.reached(410, 20.0)


def test_a_fit_ends_soon_after_held_out_tiles_no_longer_improve(monkeypatch):
    def score(done):
        return min(20 + done / 1000, last)

    # The last gain is at step 1000; the first look more than a fifth later is at 1300.
    last = 21.0
    plan, done, spent = timed(monkeypatch, seconds=1200.0, score=score)
    assert plan.stopped == 1300
    assert done == plan.steps == pytest.approx(1.5 * plan.stopped, abs=20) and spent < 1050
    # Rates go on falling from what they were: a little more than half of the stage was done.
    share = 1300 / 2410
    assert plan.schedule.share_at(plan.stopped) == pytest.approx(share, abs=0.02)
    halfway = (plan.stopped + plan.steps) // 2
    assert plan.schedule.share_at(halfway) == pytest.approx((1 + share) / 2, abs=0.02)
    assert plan.schedule.share_at(plan.steps) == 1
    # As the compiled steps see it.
    for step in (plan.stopped, halfway, plan.steps):
        found = step_schedule(plan.schedule, 0).stage.share_at(jnp.asarray(step))
        assert float(found) == pytest.approx(plan.schedule.share_at(step), abs=1e-6)
    # Not before half of the plan, though the last gain is at step 500.
    last = 20.5
    assert timed(monkeypatch, seconds=1200.0, score=score)[0].stopped == 1300


def test_a_plan_that_is_nearly_done_is_not_cut(monkeypatch):
    plan, done, _ = timed(
        monkeypatch, seconds=700.0, score=lambda done: min(20 + done / 1000, 21.0)
    )
    # Held-out tiles no longer improve from step 1300 on, of 1410.
    assert done == plan.steps == pytest.approx(1410, abs=20)
    assert not plan.stopped and plan.schedule.share == 0


def test_held_out_tiles_come_in_whole_batches_and_only_of_what_is_visible():
    dice = np.random.default_rng(0)
    pixel = dice.integers(0, 255, (4, 150, 64, 3)).astype(np.uint8)
    camera = jax.tree.map(lambda x: jnp.stack([x] * 4), toy.camera(0.0, 0.0, 80, 120))
    mask = np.full((4, 150, 8), 255, np.uint8)
    mask[0] = 0
    footage = Footage(pixel, mask, camera, np.array(["a"] * 4), 8)
    held = held_out_tiles(footage, 0.1, seed=3)
    assert 30 < held.sum() < 60 and not held[0].any()
    np.testing.assert_array_equal(held, held_out_tiles(footage, 0.1, seed=3))
    batches = held_out_batches(footage, held, tiles=16)
    assert len(batches) == held.sum() // 16 and all(b.tile.shape == (16,) for b in batches)
    for batch in batches:
        assert held[np.asarray(batch.frame), np.asarray(batch.tile)].all()
        np.testing.assert_array_equal(batch.pixel, pixel[batch.frame, batch.tile])
    assert len(held_out_batches(footage, held, tiles=100)) == 1
    pair = jax.tree.map(lambda x: x[:2], camera)
    small = Footage(pixel[:2], mask[:2], pair, np.array(["a"] * 2), 8)
    assert not held_out_tiles(small, 0.1, seed=3).any()
    assert held_out_batches(small, np.zeros((2, 150), bool), tiles=4) == []


@pytest.mark.parametrize(
    ("tiles", "held"), [(4, 0), (5, 1), (60, 12), (125, 25), (499, 25), (1000, 50)]
)
def test_a_trial_holds_out_tiles_of_small_captures_too(tiles, held):
    """Twice as many tiles, half of them masked."""
    mask = np.zeros((2, tiles, 8), np.uint8)
    mask[1] = 255
    camera = jax.tree.map(lambda x: jnp.stack([x] * 2), toy.camera(0.0, 0.0, 16, 16))
    pixel = np.zeros((2, tiles, 64, 3), np.uint8)
    footage = Footage(pixel, mask, camera, np.array(["a"] * 2), 8)
    found = trial_tiles(footage, 0.05, seed=3)
    assert found.sum() == found[1].sum() == held
    np.testing.assert_array_equal(found, trial_tiles(footage, 0.05, seed=3))


def test_a_resumed_run_keeps_the_plan():
    plan = TimedPlan(0.0, 10)
    plan.schedule = StageSchedule(540, 430, 0.4)
    noted = plan.noted(RunProgress())
    block = json.loads(json.dumps(progress_to_json(noted)))
    assert progress_from_json(block, None).planned == plan.schedule
    # As earlier versions wrote it.
    assert progress_from_json(block | {"planned": 540}, None).planned == StageSchedule(540)
    for wrong in ([540, 540, 0.4], [540, 430, 1.4], [540, 430], 0.5):
        with pytest.raises(ValueError, match="planned"):
            progress_from_json(block | {"planned": wrong}, None)
    with pytest.raises(ValueError, match="planned"):
        progress_from_json(progress_to_json(noted) | {"planned": "many"}, None)


def test_two_fits_of_a_trial_need_one_gpu_with_the_memory_for_both():
    assert Machine(True, 1, 64 << 30).runs_two_fits
    assert not Machine(True, 1, 8 << 30).runs_two_fits
    assert not Machine(True, 4, 64 << 30).runs_two_fits
    assert not CPU.runs_two_fits
