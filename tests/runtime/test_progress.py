"""Progress says how far, how long it took and how long it will take."""

import json
import time
import warnings

import pytest

from gaussray.runtime import progress as module
from gaussray.runtime.jit_cache import Clock
from gaussray.runtime.progress import Progress, end_line, plain_warnings, progress_style, say


def spoken(monkeypatch, steps, **options):
    """What is written when the clock shows `steps` = [(seconds, done), ...]."""
    now, lines = [0.0], []
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    progress = Progress("fit", 10, write=lines.append, **options)
    for seconds, done in steps:
        now[0] = seconds
        progress.report(done, "note")
    return lines


def test_the_estimate_leaves_out_the_first_report(monkeypatch):
    lines = spoken(monkeypatch, [(60, 1), (70, 2), (80, 3)])
    assert lines[-1].startswith("fit 3/10  note  1:20 spent, 1:10 left")


def test_lines_come_seconds_apart_and_the_last_one_always(monkeypatch):
    lines = spoken(monkeypatch, [(1, 1), (2, 2), (3, 3), (7, 4), (8, 10)])
    assert [line.split()[1] for line in lines] == ["1/10", "4/10", "10/10"]
    assert "0:00 left" in lines[-1]


def test_quiet_says_nothing(monkeypatch):
    assert spoken(monkeypatch, [(1, 1), (99, 10)], quiet=True) == []


def test_long_times_have_hours(monkeypatch):
    assert "2:00:00 spent" in spoken(monkeypatch, [(7200, 10)])[0]


def test_nothing_is_said_of_what_is_soon_over(monkeypatch):
    assert spoken(monkeypatch, [(1, 1), (1.9, 10)], patience=2.0) == []
    assert len(spoken(monkeypatch, [(1, 1), (2.1, 5), (3, 10)], patience=2.0)) == 2


def test_nothing_is_foretold_of_the_first_report(monkeypatch):
    assert "left" not in spoken(monkeypatch, [(60, 1)])[0]


def test_what_was_slow_at_first_is_forgotten(monkeypatch):
    # Ten seconds a unit, then one.
    lines = spoken(monkeypatch, [(1, 1), (21, 3), (23, 5), (26, 8)])
    assert lines[-1].endswith("0:26 spent, 0:02 left\n")


def test_compilation_does_not_slow_what_is_left(monkeypatch):
    compiled = iter([0.0, 5.0, 5.0, 35.0])
    monkeypatch.setattr(module, "compiled", lambda: next(compiled))
    # A second a unit, and 30 seconds of compilation before the third report.
    lines = spoken(monkeypatch, [(6, 1), (12, 7), (44, 9)])
    assert lines[-1].endswith("0:44 spent, 0:01 left\n")


def test_what_another_thread_compiles_leaves_no_less_than_nothing(monkeypatch):
    compiled = iter([0.0, 0.0, 30.0, 30.0])
    monkeypatch.setattr(module, "compiled", lambda: next(compiled))
    # 30 seconds of compilation within the 6 before the second report.
    lines = spoken(monkeypatch, [(6, 1), (12, 7), (44, 9)])
    left = [line.split(", ")[1] for line in lines[1:]]
    assert left == ["0:00 left\n", "0:04 left\n"]


def test_where_all_may_be_of_a_new_kind_compilation_is_work(monkeypatch):
    compiled = iter([0.0, 5.0, 5.0, 35.0])
    monkeypatch.setattr(module, "compiled", lambda: next(compiled))
    # From the second report to the third 2 units in 32 seconds.
    lines = spoken(monkeypatch, [(6, 1), (12, 7), (44, 9)], anew=True)
    assert lines[-1].endswith("0:44 spent, 0:16 left\n")


def test_parts_have_costs_and_compile_anew(monkeypatch):
    compiled = iter([0.0, 4.0, 4.0])
    monkeypatch.setattr(module, "compiled", lambda: next(compiled))
    # Two seconds a unit: 1 + 5 x 3 units are left, and what 4 s of the first part foretell.
    lines = spoken(monkeypatch, [(5, 1), (11, 4)], parts=[(5, 1.0), (5, 3.0)])
    assert lines[-1].endswith("0:11 spent, 0:36 left\n")


def test_pieces_of_compilation_within_one_another_count_once(monkeypatch):
    now, clock = [0.0], Clock()
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    event = "/jax/core/compile/jaxpr_trace_duration"
    for end, duration in ((2.0, 1.0), (3.0, 3.0), (5.0, 1.0), (6.0, 1.0)):
        now[0] = end
        clock.hear(event, duration)
    clock.hear("/jax/other", 100.0)
    assert clock.seconds == 5.0


def test_a_bar_fits_the_terminal_and_is_left_before_something_else_is_said(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "60")
    with progress_style("bar"):
        work = Progress("a long name of work", 3)
        work.report(1, "a note that does not fit in at all, however short the line is")
        say("said")
        end_line()
    out, err = capsys.readouterr()
    assert out == "said\n" and err.startswith("\r") and err.endswith("\n")
    assert len(err.strip("\r\n")) <= 59


def test_a_log_has_no_carriage_returns(capsys):
    with progress_style("auto"):
        Progress("fit", 2).report(2)
    assert "\r" not in capsys.readouterr().err


def test_json_is_an_object_a_line(capsys):
    with progress_style("json"):
        work = Progress("fit", 4)
        work.report(1, "one")
        work.report(4)
        say("text", "result", out="x")
    first, last, said = map(json.loads, capsys.readouterr().out.splitlines())
    assert first["event"] == "progress" and first["done"] == 1 and first["left"] is None
    assert last["left"] == 0 and last["total"] == 4
    assert said == {"event": "result", "text": "text", "out": "x"}


def test_quiet_keeps_results(capsys):
    with progress_style("quiet"):
        Progress("fit", 1).report(1)
        say("by the way")
        say("done", "result")
    out, err = capsys.readouterr()
    assert out == "done\n" and not err


def test_an_unknown_style_is_refused():
    with pytest.raises(ValueError, match="progress must be one of auto, bar, .*got 'loud'"):
        with progress_style("loud"):
            pass


def test_warnings_of_one_kind_are_a_line_and_a_count_without_their_source(capsys):
    before = warnings.showwarning
    with plain_warnings(), warnings.catch_warnings():
        warnings.simplefilter("always")
        for i in range(3):
            warnings.warn(f"images/{i}.png: {i + 1} pixels\nare black", UserWarning, stacklevel=1)
        for _ in range(2):
            warnings.warn("another text", UserWarning, stacklevel=1)
    assert capsys.readouterr().err.splitlines() == [
        "gaussray: warning: images/0.png: 1 pixels are black",
        "gaussray: warning: another text",
        "gaussray: warning: 2 more like this, the last: images/2.png: 3 pixels are black",
    ]
    assert warnings.showwarning is before


def test_a_changed_total_goes_on_in_the_same_task(monkeypatch):
    now, lines = [0.0], []
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    progress = Progress("fit", 10, write=lines.append)
    for seconds, done in [(10, 1), (11, 2)]:
        now[0] = seconds
        progress.report(done)
        progress.change_total(20)
    now[0] = 20
    progress.report(4)
    # The pause between two lines holds across the change; 2 units took 9 s.
    assert [line.split()[1] for line in lines] == ["1/10", "4/20"]
    assert "1:12 left" in lines[-1]
