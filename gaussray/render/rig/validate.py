"""What no camera can do is refused before anything is rendered."""

from collections.abc import Sequence

import numpy as np

from gaussray.dataset.manifest import FrameRecord
from gaussray.render.rig.rig import RigOptions


# Times are single precision.
ROUNDING = 1e-5


def check_possible(options: RigOptions, records: Sequence[FrameRecord]) -> None:
    """Raise a ValueError, with key and rule, unless a camera can be set so and film these frames.

    Lenses and apertures refuse by themselves what is none (`camera.lens.check_lens`,
    `camera.aperture.Aperture`), numbers in millimetres and milliseconds too (`physical`).
    """
    focus, readout = options.aperture.focus_distance, options.shutter.readout
    if not focus > 0:
        raise ValueError(f"aperture.focus_distance must be above 0, got {focus}.")
    if not readout >= 0:
        raise ValueError(
            f"shutter.readout must be at least 0, got {readout}. shutter.direction reads from the "
            "other side."
        )
    interval, exposure = _interval(records), options.shutter.exposure
    if options.shutter.kind != "keep" and exposure > interval * (1 + ROUNDING):
        raise ValueError(
            f"shutter.exposure must be at most the {interval:.6g} from one frame to the next of a "
            f"camera, got {exposure}. Lower it, or film fewer frames."
        )


def _interval(records: Sequence[FrameRecord]) -> float:
    """The least time between two frames of one camera; infinite if no camera films two."""
    times: dict[str, list[float]] = {}
    for record in records:
        times.setdefault(record.camera_name, []).append(float(record.camera.time))
    steps = [np.diff(np.unique(film)) for film in times.values()]
    return float(min((x.min() for x in steps if len(x)), default=np.inf))
