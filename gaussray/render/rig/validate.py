"""Checks that the cameras of a render are physically possible, before anything is rendered."""

from collections.abc import Sequence

import numpy as np

from gaussray.dataset.manifest import FrameRecord
from gaussray.render.rig.rig import RigOptions


# Relative rounding of times, which are single precision.
_TIME_ROUNDING = 1e-5


def check_cameras(options: RigOptions, records: Sequence[FrameRecord]) -> None:
    """Check that real cameras could take these frames.

    Lenses, apertures and physical settings check their own values (`camera.lens.check_lens`,
    `camera.aperture.Aperture`, `rig.aperture.ApertureOptions`, `physical_units`).

    Args:
        options: the rig.
        records: the frames.

    Raises:
        ValueError: A value breaks its rule; the message names the key.
    """
    readout = options.shutter.readout
    if not readout >= 0:
        raise ValueError(
            f"shutter.readout must be at least 0, got {readout}. shutter.direction reads from the "
            "other side."
        )
    interval, exposure = _frame_interval(records), options.shutter.exposure
    if options.shutter.kind != "keep" and exposure > interval * (1 + _TIME_ROUNDING):
        raise ValueError(
            f"shutter.exposure must be at most the {interval:.6g} from one frame to the next of a "
            f"camera, got {exposure}. Lower it, or render fewer frames."
        )


def _frame_interval(records: Sequence[FrameRecord]) -> float:
    """The least time between two frames of one camera; infinite if no camera has two."""
    times: dict[str, list[float]] = {}
    for record in records:
        times.setdefault(record.camera_name, []).append(float(record.camera.time))
    steps = [np.diff(np.unique(of_camera)) for of_camera in times.values()]
    return float(min((x.min() for x in steps if len(x)), default=np.inf))
