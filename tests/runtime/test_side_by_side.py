"""Pieces of work run at the same time, and end together where one of them fails."""

import threading
import time
from contextvars import ContextVar

import pytest

from gaussray.runtime.progress import Progress
from gaussray.runtime.side_by_side import demand_wanted, run_side_by_side


# Seconds after which a thread that waits for another has waited in vain.
_IN_VAIN = 20.0


def test_works_run_at_the_same_time_and_results_keep_their_order():
    meeting = threading.Barrier(2, timeout=_IN_VAIN)

    def work(value, wait):
        # Alone, nobody ever gets past it.
        meeting.wait()
        time.sleep(wait)
        return value

    assert run_side_by_side([lambda: work("a", 0.1), lambda: work("b", 0.0)]) == ["a", "b"]
    assert run_side_by_side([]) == []


def test_works_find_the_context_variables_of_the_caller():
    style = ContextVar("style", default="none")
    style.set("caller's")
    assert run_side_by_side([style.get, style.get]) == ["caller's"] * 2


def test_where_one_fails_the_others_end_at_their_next_progress_report():
    begun, reports = threading.Event(), []

    def failing():
        begun.wait(_IN_VAIN)
        raise ValueError("of the second")

    def long():
        bar = Progress("long", 10**6, quiet=True)
        begun.set()
        end = time.monotonic() + _IN_VAIN
        while time.monotonic() < end:
            bar.report(len(reports))
            reports.append(None)
            time.sleep(0.01)
        return "to the end"

    begin = time.monotonic()
    with pytest.raises(ValueError, match="of the second"):
        run_side_by_side([long, failing])
    assert reports and time.monotonic() - begin < _IN_VAIN / 2


def test_elsewhere_every_result_is_wanted():
    demand_wanted()
    assert run_side_by_side([lambda: demand_wanted()]) == [None]
    demand_wanted()
