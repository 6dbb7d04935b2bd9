"""Pieces of work run at the same time, and end together where one of them fails."""

import threading
import time
from contextvars import ContextVar

import pytest

from gaussray.runtime import side_by_side
from gaussray.runtime.progress import Progress
from gaussray.runtime.side_by_side import (
    beside,
    demand_wanted,
    mapped_in_threads,
    run_side_by_side,
    threads_within,
)


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


def test_results_of_many_items_come_in_their_order_from_several_threads():
    meeting = threading.Barrier(2, timeout=_IN_VAIN)

    def twice(k):
        # The first is done before the others; of these nobody gets past it alone.
        if k:
            meeting.wait()
        time.sleep(0.01 * (4 - k))
        return 2 * k

    assert list(mapped_in_threads(twice, range(5), threads=2)) == [0, 2, 4, 6, 8]
    assert list(mapped_in_threads(twice, [])) == []


def test_after_an_error_no_further_item_is_begun():
    begun, go_on = [], threading.Event()

    def work(k):
        begun.append(k)
        if k == 1:
            raise ValueError("of the second")
        # The only thread waits here until the error has reached the caller.
        if k:
            go_on.wait(_IN_VAIN)

    results = mapped_in_threads(work, range(100), threads=1)
    threading.Timer(0.2, go_on.set).start()
    with pytest.raises(ValueError, match="of the second"):
        list(results)
    assert len(begun) < 4


def test_threads_share_a_memory(monkeypatch):
    monkeypatch.setattr(side_by_side, "cores", lambda: 16)
    assert [threads_within(size) for size in (0, 1e6, 4e8, 9e9)] == [16, 16, 5, 1]


def test_work_beside_the_callers_ends_with_its_context():
    begun, after = threading.Event(), []

    def endless():
        begun.set()
        while True:
            demand_wanted()
            time.sleep(0.01)

    def failing():
        raise ValueError("mine")

    with beside([lambda: 3, endless, failing]) as (three, never, wrong):
        assert three.result(_IN_VAIN) == 3 and begun.wait(_IN_VAIN)
        assert isinstance(wrong.exception(_IN_VAIN), ValueError)
        after.append(never.done())
    assert after == [False]
    assert isinstance(never.exception(_IN_VAIN), side_by_side.GivenUp)


def test_work_beside_work_that_is_given_up_is_given_up_too():
    begun = threading.Event()

    def endless():
        begun.set()
        while True:
            demand_wanted()
            time.sleep(0.01)

    def waiting():
        with beside([endless]) as (inner,):
            # As one who waits for a lock that the inner work holds.
            inner.exception(_IN_VAIN)
            return inner.done()

    def failing():
        begun.wait(_IN_VAIN)
        raise ValueError("other")

    start = time.monotonic()
    with pytest.raises(ValueError, match="other"):
        run_side_by_side([waiting, failing])
    assert time.monotonic() - start < _IN_VAIN
