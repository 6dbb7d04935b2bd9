"""One result of a check of the input."""

from typing import NamedTuple


class Finding(NamedTuple):
    """One result of a check.

    Args:
        level: `good`, `warn` or `refuse`.
        subject: what it is about: sync, cameras, lens, points, epipolar lines, exposure.
        text: what was found.
        remedy: what to do about it; empty if nothing.
    """

    level: str
    subject: str
    text: str
    remedy: str = ""
