"""Options of `calibrate`: which camera parameters are estimated, and from which pictures."""

import equinox as eqx

from gaussray.calibrate.parameters import KINDS


class CalibrateOptions(eqx.Module):
    """Which camera parameters are estimated, and from which pictures of the capture.

    All chosen cameras share the focal length, the lens and the shutter's readout. Pose, exposure
    and time offset are estimated for each camera.

    Args:
        parameters: some of `focal`; `lens` (principal point and distortion coefficients); `shutter`
            (readout time); `pose`; `exposure` (a gain per colour channel); `offset` (a constant
            delay of a camera's timestamps).
        coefficients: names of the lens coefficients to estimate. Empty: those that are not 0.
        effect: the group of pictures to use. Empty: the pinhole views, or the only group.
        split: `train`, `test` or `all`.
        cameras: names of the cameras to calibrate. Empty: all.
        frames: the largest number of pictures per camera, evenly spread in time. 0: all.
        samples: rays per pixel. 0: 1, or 4 where an aperture or an exposure blurs the picture.
        coarsest: blocks along the smaller side of the picture at the first, coarsest level. Each
            following level doubles them, up to single pixels.
        steps: the largest number of Levenberg-Marquardt steps per level.
        huber_threshold: residuals above this many standard deviations count linearly (Huber loss).

    Raises:
        ValueError: If an option is out of range. The message names its key.
    """

    parameters: tuple[str, ...] = eqx.field(static=True, default=("pose", "focal"))
    coefficients: tuple[str, ...] = eqx.field(static=True, default=())
    effect: str = eqx.field(static=True, default="")
    split: str = eqx.field(static=True, default="all")
    cameras: tuple[str, ...] = eqx.field(static=True, default=())
    frames: int = eqx.field(static=True, default=0)
    samples: int = eqx.field(static=True, default=0)
    coarsest: int = eqx.field(static=True, default=16)
    steps: int = eqx.field(static=True, default=20)
    huber_threshold: float = eqx.field(static=True, default=1.345)

    def __check_init__(self):
        unknown = [kind for kind in self.parameters if kind not in KINDS]
        if unknown or not self.parameters:
            raise ValueError(
                f"calibrate.parameters must be some of {', '.join(KINDS)}, got "
                f"{list(self.parameters)}."
            )
        if self.coefficients and "lens" not in self.parameters:
            raise ValueError(
                "calibrate.coefficients must be empty unless calibrate.parameters has lens, got "
                f"{list(self.coefficients)}. Add lens to calibrate.parameters."
            )
        if self.split not in ("train", "test", "all"):
            raise ValueError(f"calibrate.split must be train, test or all, got {self.split!r}.")
        for name, least in (("frames", 0), ("samples", 0), ("coarsest", 1), ("steps", 1)):
            if getattr(self, name) < least:
                raise ValueError(
                    f"calibrate.{name} must be at least {least}, got {getattr(self, name)}."
                )
        if not self.huber_threshold > 0:
            raise ValueError(
                f"calibrate.huber_threshold must be above 0, got {self.huber_threshold}."
            )
