"""What several fits of the same pictures have in common, found once."""

import threading
from collections.abc import Callable, Hashable
from typing import Any, TypeVar


T = TypeVar("T")


class SharedResults:
    """Results of work on the pictures of one segment, which trials and the fit itself share.

    They are the pictures, the points and motion that these alone decide, and the sizes of the
    tracer's lists, so that the steps of later fits run the programs that were compiled for earlier
    ones. Fits may ask for them at the same time, from several threads.
    """

    def __init__(self):
        self._found: dict[Hashable, Any] = {}
        self._turns: dict[Hashable, threading.RLock] = {}
        self._lock = threading.Lock()

    def once(self, key: Hashable, find: Callable[[], T]) -> T:
        """The result of this name, found now if it is asked for the first time; whoever asks
        meanwhile waits for it.

        Args:
            key: what is found, and all options that it depends on.
            find: finds it.
        """
        with self.turn(key):
            if key not in self._found:
                self._found[key] = find()
            return self._found[key]

    def turn(self, key: Hashable) -> threading.RLock:
        """A lock of this name: in its context there is one fit at a time.

        Args:
            key: what must not be found by two fits at once.
        """
        with self._lock:
            return self._turns.setdefault(key, threading.RLock())

    def known(self, key: Hashable) -> Any | None:
        """The result of this name; None if there is none."""
        return self._found.get(key)

    def note(self, key: Hashable, result: object) -> None:
        """Keep a result, in place of an earlier one.

        Args:
            key: what it is, and all options that it depends on.
            result: the result.
        """
        self._found[key] = result
