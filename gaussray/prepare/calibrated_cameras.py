"""Whether a calibration has the cameras of enough videos."""

from collections.abc import Mapping, Sequence

from gaussray.prepare.errors import PrepareError
from gaussray.runtime.output import listed_names


def check_calibrated_cameras(
    names: Sequence[str], absent: Sequence[str], left_out: Mapping[str, str]
) -> None:
    """Refuse a single calibrated camera: points are seen by two.

    Args:
        names: cameras of the input that have a pose.
        absent: cameras of the calibration, with a pose, that the input has no video of.
        left_out: for each camera without a pose what the calibration lacks (`Calibration`).
    """
    if len(names) > 1:
        return
    others = ""
    if absent:
        others = (
            "Add the videos of the other cameras of the calibration, which have none: "
            f"{listed_names(absent)}. "
        )
    for name, reason in left_out.items():
        others += f"{name} does not count, because it {reason}. "
    raise PrepareError(
        f"poses.calibration must be of at least two cameras with a video, got "
        f"{names[0]} alone: one camera that stands still tells no depth. {others}If this "
        "camera moves, leave poses.calibration out (poses.rig=moving says that it does, and "
        "poses.lens=FILE tells its lens)."
    )
