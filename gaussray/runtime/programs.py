"""A bounded cache of compiled programs, which releases the memory of those that it forgets."""

import functools
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any


class ProgramCache:
    """Decorates a function that makes compiled programs: it keeps the `most` used last.

    A forgotten program gives back its memory mappings, of which Linux allows a process 65,530; a
    program for a CPU takes up to 1,000 of them.
    """

    def __init__(self, most: int):
        self.most = most
        self._programs: OrderedDict[Hashable, Any] = OrderedDict()
        self._lock = threading.Lock()

    def __call__(self, make: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(make)
        def program(*key: Hashable) -> Any:
            with self._lock:
                if key not in self._programs:
                    self._programs[key] = make(*key)
                self._programs.move_to_end(key)
                if len(self._programs) > self.most:
                    _, forgotten = self._programs.popitem(last=False)
                    forgotten.clear_cache()
                return self._programs[key]

        return program
