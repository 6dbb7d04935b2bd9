"""What a run leaves on disk is lost neither to a run that is refused nor to one that goes on."""

import pytest

from gaussray.fit.journal import Journal


LINE = '{"stage": "coarse", "step": 10}\n'


@pytest.fixture
def left(tmp_path):
    """The figures of an earlier run."""
    (tmp_path / "metrics.jsonl").write_text(LINE)
    return tmp_path


def test_an_unfinished_run_is_refused_and_keeps_its_figures(left):
    (left / "checkpoint.npz").touch()
    with pytest.raises(ValueError, match="unfinished reconstruction. Add resume=true"):
        Journal(left, resume=False, interval=0.0)
    assert (left / "metrics.jsonl").read_text() == LINE


def test_a_run_that_goes_on_keeps_its_figures(left):
    (left / "checkpoint.npz").touch()
    Journal(left, resume=True, interval=0.0)
    assert (left / "metrics.jsonl").read_text() == LINE


def test_where_a_run_was_finished_a_new_one_begins_its_own_figures(left):
    Journal(left, resume=False, interval=0.0)
    assert (left / "metrics.jsonl").read_text() == ""


def test_where_nothing_was_left_there_is_nothing_to_go_on_with(tmp_path):
    with pytest.raises(FileNotFoundError, match="holds no checkpoint.npz"):
        Journal(tmp_path / "new", resume=True, interval=0.0)
    assert not (tmp_path / "new").exists()
