"""Progress says how far, how long it took and how long it will take."""

import time

from gaussray.progress import Progress


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
