"""Which of the cameras of a file a video or folder is of, by their names."""

import re
from collections.abc import Sequence


def like_name(known: Sequence[str], name: str) -> str | None:
    """The one of some names that is like another: the same; else of the same letters and digits,
    whatever their case; else of the same last number (`cam01`, `1`); else a part of it (`back` of
    `session_back`). None if none is, or several are.

    Args:
        known: names of a file's cameras.
        name: name of a video or folder.
    """
    for rule in (str, lambda text: re.sub(r"[^a-z0-9]", "", text.lower()), _number):
        alike = [other for other in known if rule(other) == rule(name) != ""]
        if len(alike) == 1:
            return alike[0]
    parts = re.split(r"[^a-z0-9]+", name.lower())
    alike = [other for other in known if other.lower() in parts]
    return alike[0] if len(alike) == 1 else None


def _number(name: str) -> str:
    """The last number in a name, without leading zeros."""
    digits = re.findall(r"\d+", name)
    return str(int(digits[-1])) if digits else ""
