"""Whether a calibration has the cameras of enough videos."""

from collections.abc import Sequence

from gaussray.prepare.calibrations.known_camera import Calibration
from gaussray.prepare.calibrations.like_names import like_name
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.findings.listed_names import listed_names
from gaussray.prepare.sources import Source


def check_calibrated_cameras(calibration: Calibration, sources: Sequence[Source]) -> None:
    """Refuse a single calibrated camera: points are seen by two.

    Args:
        calibration: the cameras of the file.
        sources: cameras of the input that have a pose.
    """
    if len(sources) > 1:
        return
    names = [camera.name for camera in calibration.cameras]
    used = {like_name(names, source.name) for source in sources}
    absent = [name for name in names if name not in used]
    others = ""
    if absent:
        listed = listed_names(absent)
        others = (
            f"Add the videos of the other cameras of the calibration, which have none: {listed}. "
        )
    for name, reason in calibration.left_out.items():
        others += f"{name} does not count, because {reason}. "
    raise PrepareError(
        f"poses.calibration must be of at least two cameras with a video, got "
        f"{sources[0].name} alone: one camera that stands still tells no depth. {others}If this "
        "camera moves, leave poses.calibration out (poses.rig=moving says that it does, and "
        "poses.lens=FILE tells its lens)."
    )
