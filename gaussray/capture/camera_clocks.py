"""Cameras whose times are counted in another unit than those of the others."""

import warnings

import numpy as np

from gaussray.capture.capture import Capture
from gaussray.capture.errors import CaptureWarning


# A camera took about as many pictures as usual if their numbers differ by less than this share,
# but over another time if that is so many times as long or as short. Fewer pictures tell nothing.
_ALIKE, _OTHER, _FEWEST = 0.2, 1.5, 5


def warn_of_other_clocks(capture: Capture) -> None:
    """Warn of cameras that took as many pictures as others, over a much longer or shorter time.

    Args:
        capture: the capture as selected.
    """
    times: dict[str, list[float]] = {}
    for view in capture.views:
        times.setdefault(view.camera_name, []).append(view.time)
    known = {name: np.unique(own) for name, own in times.items() if len(set(own)) >= _FEWEST}
    if len(known) < 2:
        return
    count = np.median([len(own) for own in known.values()])
    usual = sorted(known.values(), key=np.ptp)[(len(known) - 1) // 2]
    others = [
        (name, own)
        for name, own in known.items()
        if abs(len(own) - count) < _ALIKE * count
        and max(np.ptp(own) / np.ptp(usual), np.ptp(usual) / np.ptp(own)) > _OTHER
    ]
    if others:
        name, own = others[0]
        more = f" and of {len(others) - 1} other cameras" if len(others) > 1 else ""
        warnings.warn(
            f"{capture.folder}: the {len(own)} pictures of {name}{more} have times from "
            f"{own[0]:g} to {own[-1]:g}, those of other cameras from {usual[0]:g} to "
            f"{usual[-1]:g}. Count all times in one unit, seconds or frames, from one moment.",
            CaptureWarning,
            stacklevel=3,
        )
