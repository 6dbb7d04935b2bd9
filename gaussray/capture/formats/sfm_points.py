"""The sparse points of structure-from-motion projects, which a reconstruction starts from."""

from collections.abc import Iterable, Sequence
from itertools import chain
from typing import Any

import numpy as np
from jaxtyping import Float

from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.points import Points
from gaussray.capture.world_origin import counted_positions
from gaussray.color import srgb_decode
from gaussray.io.safe.limits import within


# Linear light of points without a colour.
_GRAY = 0.5


def given_points(
    top: Keys,
    key: str,
    positions: Sequence[Any] | np.ndarray,
    colors: Sequence[Any] | np.ndarray | None,
) -> Points | None:
    """The points of a project; None if it has none.

    Args:
        top: the file, for messages.
        key: where it has the points.
        positions: three numbers each, which may be texts.
        colors: red, green and blue each, 0 to 255. None: all are gray, with a warning.

    Raises:
        CaptureError: a point has other numbers.
    """
    within(top.file, "the millions of points", len(positions), "points", 1e6)
    if not len(positions):
        return None
    place = counted_positions(_triples(top, key, "position", positions)).astype(np.float32)
    if colors is None:
        top.warn(f"its points have no colour; all are gray {_GRAY}.")
        return Points(place, np.full_like(place, _GRAY))
    levels = _triples(top, key, "color", colors)
    outside = np.flatnonzero((levels < 0).any(axis=1) | (levels > 255).any(axis=1))
    if len(outside):
        raise _point(top, key, "color", int(outside[0]), colors).error("color", "from 0 to 255")
    return Points(place, srgb_decode(levels / 255).astype(np.float32))


def _triples(
    top: Keys, key: str, name: str, values: Sequence[Any] | np.ndarray
) -> Float[np.ndarray, "points 3"]:
    """Three numbers of each point, which fit into 32 bits."""
    table = _table(values)
    if _fits(table, (len(values), 3)):
        return table
    wrong = next((k for k, row in enumerate(values) if not _fits(_table(row), (3,))), 0)
    raise _point(top, key, name, wrong, values).error(name, "three finite numbers")


def _point(top: Keys, key: str, name: str, index: int, values: Sequence[Any] | np.ndarray) -> Keys:
    """The keys of a point, for the message about one of them."""
    value = values[index]
    value = value.tolist() if isinstance(value, np.ndarray) else value
    return Keys(top.file, {name: value}, index, f"{key}: ", "point")


def _table(values: Any) -> np.ndarray:
    """The numbers in a list, or in a list of lists; none if it has something else."""
    if isinstance(values, np.ndarray):
        return values
    try:
        table = np.array(values, np.float64)
    except (TypeError, ValueError, OverflowError):
        return np.zeros(0)
    # NumPy takes true for 1.
    flat: Iterable[Any] = chain.from_iterable(values) if table.ndim == 2 else values
    return np.zeros(0) if table.ndim in (1, 2) and bool in set(map(type, flat)) else table


def _fits(table: np.ndarray, shape: tuple[int, ...]) -> bool:
    return table.shape == shape and bool((np.abs(table) < np.finfo(np.float32).max).all())
