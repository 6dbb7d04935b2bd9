"""What a run leaves on disk is lost neither to a run that is refused nor to one that goes on."""

import re
import shutil

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.reconstruct.log import NonFiniteLoss, RunLog
from gaussray.reconstruct.optimize.optimizer import Parameters
from gaussray.reconstruct.optimize.state import begin_state
from gaussray.reconstruct.run_progress import RunProgress
from gaussray.scene.gaussians import unconstrain


LINE = '{"stage": "coarse", "step": 10}\n'


@pytest.fixture
def left(tmp_path):
    """The figures of an earlier run."""
    (tmp_path / "metrics.jsonl").write_text(LINE)
    return tmp_path


@pytest.fixture
def state():
    """One before its first step."""
    free = unconstrain(toy.gaussians(np.zeros((2, 3)), 0.1, 0.5))
    return begin_state(Parameters(free, free, None))


def test_an_unfinished_run_is_refused_and_keeps_its_figures(left):
    (left / "checkpoint.npz").touch()
    with pytest.raises(ValueError, match="unfinished reconstruction. Add resume=true"):
        RunLog(left, resume=False, interval=0.0)
    assert (left / "metrics.jsonl").read_text() == LINE


def test_a_run_that_goes_on_keeps_its_figures(left):
    (left / "checkpoint.npz").touch()
    RunLog(left, resume=True, interval=0.0)
    assert (left / "metrics.jsonl").read_text() == LINE


def test_where_a_run_was_finished_a_new_one_begins_its_own_figures(left):
    RunLog(left, resume=False, interval=0.0)
    assert (left / "metrics.jsonl").read_text() == ""


def test_where_nothing_was_left_there_is_nothing_to_go_on_with(tmp_path):
    with pytest.raises(FileNotFoundError, match="holds no checkpoint.npz"):
        RunLog(tmp_path / "new", resume=True, interval=0.0)
    assert not (tmp_path / "new").exists()


def test_lines_of_steps_after_the_saved_state_are_taken_away(tmp_path, state):
    log = RunLog(tmp_path, resume=False, interval=0.0)
    metrics = tmp_path / "metrics.jsonl"
    metrics.write_text(LINE)
    log.save(state, RunProgress())
    metrics.write_text(LINE + LINE + LINE[:9])
    RunLog(tmp_path, resume=True, interval=0.0).resumed()
    assert metrics.read_text() == LINE


def test_a_folder_that_has_gone_is_told(tmp_path, state):
    log = RunLog(tmp_path / "run", resume=False, interval=0.0)
    shutil.rmtree(tmp_path / "run")
    with pytest.raises(OSError, match="metrics.jsonl: cannot be written"):
        log.record(RunProgress(), 1, {"mse": jnp.ones(())}, 3)


@pytest.mark.parametrize(
    ("name", "key"),
    [
        ("moving.logit_opacity", "optimizer.opacity"),
        ("deformation.trunk.bias", "optimizer.network"),
        ("deformation.planes.lower", "optimizer.planes"),
        ("deformation.mean[0].bias", "optimizer.network"),
        ("deformation.mean[1].bias", "optimizer.mean_head"),
        ("deformation.bodies.turn", "optimizer.turn"),
        ("deformation.control.turn", "optimizer.control_turn"),
    ],
)
def test_a_parameter_that_is_not_finite_is_named_with_the_rate_to_lower(tmp_path, name, key):
    free = unconstrain(toy.gaussians(np.zeros((2, 3)), 0.1, 0.5))
    before = begin_state(Parameters(free, free, toy.deformation(control=toy.control_points())))

    def place(state):
        node = state.parameters
        for part in re.findall(r"\w+", name):
            node = node[int(part)] if part.isdigit() else getattr(node, part)
        return node

    after = eqx.tree_at(place, before, place(before).at[0].set(np.inf))
    log = RunLog(tmp_path, resume=False, interval=0.0)
    with pytest.raises(NonFiniteLoss) as found:
        log.demand_finite({"l1": jnp.asarray(0.1)}, before, after, RunProgress(stage="fine"))
    told = str(found.value)
    assert told.startswith(f"{name} became infinite or not a number between steps 0 and 0 of the")
    assert f"resume=true and a smaller {key} (" in told
    state, progress = RunLog(tmp_path, resume=True, interval=0.0).resumed()
    assert progress.stage == "fine" and np.isfinite(place(state)).all()


@pytest.mark.parametrize(
    ("term", "key"), [("l1", "loss.l1"), ("opacity_cost", "density.opacity_cost")]
)
def test_a_term_that_is_not_finite_is_named_by_its_weight(tmp_path, state, term, key):
    log = RunLog(tmp_path, resume=False, interval=0.0)
    with pytest.raises(NonFiniteLoss, match=f"^{key} became infinite or not a number"):
        log.demand_finite({term: jnp.asarray(np.nan)}, state, state, RunProgress())
