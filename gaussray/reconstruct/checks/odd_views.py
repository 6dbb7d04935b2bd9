"""Single cameras whose poses contradict the pictures, while those of the others fit."""

import numpy as np

from gaussray.capture.odd_cameras import JudgedPair, odd_cameras
from gaussray.reconstruct.checks.matched_details import (
    FEWEST_MATCHES,
    PosedViews,
    is_of_one_thing,
    line_offsets,
    nearest_pairs,
)


# Neighbours of a picture with which it is compared.
_NEIGHBOURS = 3
# Median distances in pixels of reduced pictures up to which the matches of a pair fit, and from
# which on they do not.
_FITS, _OFF = 1.5, 3.0
# Neighbours of a camera that are listed, at most.
_LISTED = 3


def odd_views_sentence(views: PosedViews) -> str:
    """A sentence about the cameras whose details are off while those of the others fit; empty if
    there are none."""
    judged, offs = {}, {}
    for match in views.matches(nearest_pairs(views.rotation, views.eye, neighbours=_NEIGHBOURS)):
        count = len(match.one.ray)
        if count < FEWEST_MATCHES:
            continue
        off = float(np.median(line_offsets(match, views.rotation, views.eye)))
        if off <= _FITS or (off >= _OFF and is_of_one_thing(match)):
            pair = str(match.first), str(match.second)
            judged[pair], offs[pair] = JudgedPair(count, off <= _FITS), off
    odd = odd_cameras(judged)
    if not odd:
        return ""
    parts = []
    for view in odd:
        own = {
            b if a == view else a: off
            for (a, b), off in offs.items()
            if view in (a, b) and not judged[a, b].fits
        }
        listed = [
            f"{own[k]:.1f} pixels off with {_shown_name(views, k)}"
            for k in sorted(own, key=lambda k: -own[k])[:_LISTED]
        ]
        parts.append(f"those of {_shown_name(views, view)} lie {', '.join(listed)}")
    rest = np.median([off for pair, off in offs.items() if not set(odd) & set(pair)])
    text = (
        "details that neighbouring pictures share lie where the poses put them "
        f"({rest:.1f} pixels), but {'; '.join(parts)}. Pose or lens are wrong there, as those of a "
        "camera that was moved or turned since. fit.refine=[pose,lens] mends small errors"
    )
    name = _frame_name(views, odd[0])
    if np.sum(views.footage.name[views.chosen] == name) > 1:
        return f"{text}."
    return f"{text}; to fit without it, hold it out: capture.test=['{name}']."


def _frame_name(views: PosedViews, view: str) -> str:
    return str(views.footage.name[views.chosen[int(view)]])


def _shown_name(views: PosedViews, view: str) -> str:
    """The camera's name, with the time if it moves."""
    name, frame = _frame_name(views, view), views.chosen[int(view)]
    alone = np.sum(views.footage.name[views.chosen] == name) == 1
    return name if alone else f"{name} at time {views.footage.times[frame]:.8g}"
