"""Options of `gaussray prepare`: synchronisation, frames, poses."""

import equinox as eqx


METHODS = ("auto", "sound", "motion", "none")
LENS_MODELS = ("pinhole", "radial", "opencv", "opencv_fisheye")
INTRINSICS_CHOICES = ("auto", "shared", "own")
# fx fy cx cy alone, and with OpenCV's four, five or eight coefficients.
_LENS_NUMBERS = (4, 8, 9, 12)
RIGS = ("auto", "still", "moving")


def _one_of(key: str, value: str, choices: tuple[str, ...]) -> None:
    if value not in choices:
        raise ValueError(f"{key} must be one of {', '.join(choices)}, got {value!r}.")


class SyncOptions(eqx.Module):
    """How the clocks of the cameras are compared.

    Args:
        method: `sound` compares sound tracks, `motion` the changes between frames; `auto` is sound,
            and motion for videos that sound does not link with the others; `none` takes all videos
            to start together.
        offsets: known seconds by which each video starts after the first camera's clock, in the
            order of the names; empty to estimate them.
        longest: largest offset that is searched, in seconds.
        trust: least confidence, in 0..1, of an estimate that is used.
    """

    method: str = eqx.field(static=True, default="auto")
    offsets: tuple[float, ...] = eqx.field(static=True, default=())
    longest: float = eqx.field(static=True, default=30.0)
    trust: float = eqx.field(static=True, default=0.3)

    def __check_init__(self):
        _one_of("sync.method", self.method, METHODS)
        if not self.longest > 0:
            raise ValueError(f"sync.longest must be above 0, got {self.longest}.")
        if not 0 <= self.trust <= 1:
            raise ValueError(f"sync.trust must be in [0, 1], got {self.trust}.")


class FramesOptions(eqx.Module):
    """Which frames make the capture.

    Args:
        rate: timestamps per second; 0 is the lowest rate of the videos, or 30 for folders, but of
            one folder alone photographs of a scene that stands still. Of videos of cameras that
            move each k-th timestamp is then used, so that their pictures are at most 200 together.
        span: first and last second of the common time; empty is all that the cameras share.
        readout: seconds from the first to the last row of a rolling shutter; 0 is a global shutter.
        instants: timestamps whose pictures are matched to find poses of cameras that stand still.
    """

    rate: float = eqx.field(static=True, default=0.0)
    span: tuple[float, ...] = eqx.field(static=True, default=())
    readout: float = eqx.field(static=True, default=0.0)
    instants: int = eqx.field(static=True, default=5)

    def __check_init__(self):
        if self.rate < 0:
            raise ValueError(f"frames.rate must be at least 0, got {self.rate}.")
        if len(self.span) not in (0, 2) or (self.span and not self.span[0] <= self.span[1]):
            raise ValueError(
                f"frames.span must be empty or [first, last] in seconds, got {list(self.span)}."
            )
        if self.instants < 1:
            raise ValueError(f"frames.instants must be at least 1, got {self.instants}.")


class PosesOptions(eqx.Module):
    """How poses, lenses and points are found.

    Args:
        calibration: file or folder of a known calibration; empty to estimate poses and lenses.
        model: lens model that is estimated: `pinhole` (one focal length), `radial` (and one
            coefficient), `opencv` (two focal lengths, four coefficients) or `opencv_fisheye`.
        intrinsics: whether the cameras have `shared` or `own` intrinsics; `auto` shares them
            between cameras whose pictures have one size.
        lens: known lens of cameras whose poses are estimated, which then stays as it is: a file
            with one lens, or with one for each camera by name, or fx, fy, cx, cy in pixels and up
            to eight distortion coefficients k1, k2, p1, p2, k3, ... as OpenCV has them (the middle
            of the first pixel is at 0, 0); None estimates it.
        fov: rough horizontal field of view in degrees to start from; 0 is unknown.
        rig: whether the cameras stand `still` or are `moving`; `auto` looks at the pictures.
        features: most SIFT features of a picture.
        masks: whether features are sought where masks are white alone: of an object that turns
            before a background that stands still.
        seed: seed of the random samples.
    """

    calibration: str = eqx.field(static=True, default="")
    model: str = eqx.field(static=True, default="radial")
    intrinsics: str = eqx.field(static=True, default="auto")
    lens: str | tuple[float, ...] | None = eqx.field(static=True, default=None)
    fov: float = eqx.field(static=True, default=0.0)
    rig: str = eqx.field(static=True, default="auto")
    features: int = eqx.field(static=True, default=8192)
    masks: bool = eqx.field(static=True, default=False)
    seed: int = eqx.field(static=True, default=0)

    def __check_init__(self):
        _one_of("poses.model", self.model, LENS_MODELS)
        _one_of("poses.intrinsics", self.intrinsics, INTRINSICS_CHOICES)
        _one_of("poses.rig", self.rig, RIGS)
        limit = 360 if self.model == "opencv_fisheye" else 180
        if not 0 <= self.fov < limit:
            raise ValueError(f"poses.fov must be in [0, {limit}) degrees, got {self.fov}.")
        if isinstance(self.lens, tuple) and len(self.lens) not in _LENS_NUMBERS:
            raise ValueError(
                "poses.lens must be a file or the numbers [fx,fy,cx,cy], with k1,k2,p1,p2 after "
                f"them, then k3, or k3 to k6, got {len(self.lens)} numbers."
            )
        if isinstance(self.lens, tuple) and min(self.lens[:2]) <= 0:
            raise ValueError(f"poses.lens must have fx and fy above 0, got {list(self.lens)}.")
        if self.lens is not None and (self.calibration or self.fov):
            other = "calibration" if self.calibration else "fov"
            raise ValueError(
                f"poses.lens must be null with poses.{other}, which tells the lens as well, got "
                f"both. Leave one of them out."
            )


class PrepareOptions(eqx.Module):
    """All options of `gaussray prepare`."""

    sync: SyncOptions = SyncOptions()
    frames: FramesOptions = FramesOptions()
    poses: PosesOptions = PosesOptions()
