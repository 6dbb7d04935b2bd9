"""What several fits of the same pictures have in common, found once."""

from collections.abc import Callable, Hashable
from typing import Any, TypeVar


T = TypeVar("T")


class SharedResults:
    """Results of work on the pictures of one segment, which trials and the fit itself share.

    They are the pictures, the points and motion that these alone decide, and the sizes of the
    tracer's lists, so that the steps of later fits run the programs that were compiled for earlier
    ones.
    """

    def __init__(self):
        self._found: dict[Hashable, Any] = {}

    def once(self, key: Hashable, find: Callable[[], T]) -> T:
        """The result of this name, found now if it is asked for the first time.

        Args:
            key: what is found, and all options that it depends on.
            find: finds it.
        """
        if key not in self._found:
            self._found[key] = find()
        return self._found[key]

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
