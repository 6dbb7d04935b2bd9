"""Which masks of a capture were written by `prepare`: the next run replaces these, and no other."""

import json
from collections.abc import Collection
from pathlib import Path

from gaussray.io.atomic import write_json


# Beside the folders of masks. It has no second dot, so that it does not look like a mask.
_RECORD = ".gaussray"


def recorded_masks(home: Path) -> frozenset[Path]:
    """The masks that an earlier run has written into a capture, without symbolic links in their
    paths; none if there is no record, or one that is damaged.

    Args:
        home: the folder of masks, which may not exist.
    """
    try:
        names = json.loads((home / _RECORD).read_text())["masks"]
        found = [(home / name).resolve() for name in names]
    except (OSError, ValueError, TypeError, KeyError):
        return frozenset()
    inside = home.resolve()
    return frozenset(path for path in found if path.is_relative_to(inside))


def record_masks(home: Path, masks: Collection[Path]) -> None:
    """Write down which masks of a capture are written by this run.

    Args:
        home: the folder of masks.
        masks: resolved paths of masks in it.
    """
    if not masks:
        (home / _RECORD).unlink(missing_ok=True)
        return
    inside = home.resolve()
    names = sorted(path.relative_to(inside).as_posix() for path in masks)
    write_json(home / _RECORD, {"masks": names})
