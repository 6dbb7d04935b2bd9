"""Several pieces of work at the same time: all of them, or as many as there are threads."""

import contextlib
import contextvars
import itertools
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextvars import ContextVar
from typing import TypeVar

from gaussray.runtime.devices import cores


T = TypeVar("T")
U = TypeVar("U")

# Bytes that threads which work on large arrays take together.
_MEMORY = 2e9

# One of them is set once nobody wants the result of this thread's work any more.
_given_up: ContextVar[tuple[threading.Event, ...]] = ContextVar("given_up", default=())


class GivenUp(Exception):
    """Nobody wants the result of this work any more."""


def demand_wanted() -> None:
    """Raise `GivenUp` in a thread whose result nobody wants any more.

    Long work calls this between its steps (`Progress.report` does).
    """
    if any(event.is_set() for event in _given_up.get()):
        raise GivenUp


def run_side_by_side(works: Sequence[Callable[[], T]]) -> list[T]:
    """The results of several pieces of work, each done in a thread of its own.

    If one fails, or the user interrupts, the others are given up at their next progress report.

    Args:
        works: functions of nothing. They find the context variables of the caller.

    Raises:
        Exception: that of the first work that failed, in the order of `works`.
    """
    given_up = threading.Event()

    def done(work: Callable[[], T]) -> T:
        _given_up.set((*_given_up.get(), given_up))
        try:
            return work()
        except BaseException:
            given_up.set()
            raise

    with ThreadPoolExecutor(max(len(works), 1), "side") as threads:
        futures = [threads.submit(contextvars.copy_context().run, done, work) for work in works]
        try:
            wait(futures)
        except BaseException:
            given_up.set()
            raise
    errors = [future.exception() for future in futures]
    causes = [error for error in errors if error and not isinstance(error, GivenUp)]
    if causes:
        raise causes[0]
    return [future.result() for future in futures]


@contextlib.contextmanager
def beside(works: Sequence[Callable[[], T]]) -> Iterator[list[Future[T]]]:
    """In this context several pieces of work are done by threads; what is not done when it ends is
    given up at its next progress report.

    Args:
        works: functions of nothing. They find the context variables of the caller.

    Returns:
        Their results, or the exceptions that they raised.
    """
    given_up = threading.Event()

    def done(work: Callable[[], T]) -> T:
        _given_up.set((*_given_up.get(), given_up))
        return work()

    threads = ThreadPoolExecutor(max(len(works), 1), "beside")
    try:
        yield [threads.submit(contextvars.copy_context().run, done, work) for work in works]
    finally:
        given_up.set()
        threads.shutdown(wait=False, cancel_futures=True)


def threads_within(size: float) -> int:
    """As many threads as there are processors, but no more than take 2 GB together; one at least.

    Args:
        size: bytes that one of them takes.
    """
    return max(1, min(cores(), int(_MEMORY / max(size, 1))))


def mapped_in_threads(
    function: Callable[[T], U], items: Iterable[T], threads: int | None = None
) -> Iterator[U]:
    """The results of a function for each of many items, in their order, as `map` gives them.

    It helps where the function spends its time outside of Python: in NumPy, which computes with
    large arrays while other threads go on, in decoders, or waiting for a device. The first item is
    done before the others: the programs that it compiles serve all.

    Args:
        function: called in threads, for several items at a time.
        items: all of them are taken at once.
        threads: how many; None: as many as there are processors.
    """
    waiting = iter(items)
    yield from map(function, itertools.islice(waiting, 1))
    pool = ThreadPoolExecutor(threads or cores(), "map")
    try:
        yield from pool.map(function, waiting)
    finally:
        # Whoever interrupts, or needs no more, does not wait for the rest.
        pool.shutdown(cancel_futures=True)
