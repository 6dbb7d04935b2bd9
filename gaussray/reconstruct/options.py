"""The options of a reconstruction: one class per group of conf/, put together."""

import equinox as eqx

from gaussray.camera.corrections import REFINABLE
from gaussray.reconstruct.initialize.body_tracking import TrackOptions
from gaussray.reconstruct.optimize.density import DensityOptions
from gaussray.reconstruct.optimize.loss import LossOptions
from gaussray.reconstruct.optimize.optimizer import OptimizerOptions
from gaussray.reconstruct.simplify.prune import NeedOptions
from gaussray.scene.deformation import FieldOptions
from gaussray.tracer.trace import TraceOptions


class FitOptions(eqx.Module):
    """The course of a reconstruction.

    With `auto`, what has its default is chosen by device and capture (`effort`); a capture of one
    time then takes `minutes` instead of a number of steps, or less: a share `validate` of its tiles
    is held out, and the fit ends soon after these no longer improve.

    `coarse` steps on the first instant, without deformation; `fine` steps on all (both on one
    instant, if there are no others). A step sees `tiles` tiles of `tile_side` x `tile_side` pixels
    (whole ray bundles), a share `error` of them in proportion to the errors last seen there, and of
    the others a share `balance` where things move. Gaussians whose pixels change more than a share
    `moving` of the time get a deformation. A block of `block` steps runs without the host;
    `checkpoint` is the interval in seconds between saved states. Pictures of more than `memory`
    gigabytes are kept in a file. A capture of more than `segment` instants is cut into segments of
    at most so many (0: into none), of which each takes `fine` steps and loads its own pictures;
    neighbours share an instant, at which the later one starts from what the other found.

    `points` random points are the start if the capture has none; of those that it has, points go
    that are further from their neighbours than usual by more than `outliers` standard deviations (0
    keeps all, see `initial.inliers`), of fewer than `points` the rest are put between them
    (`initial.between`), and around them `surround` times as many random ones are added
    (`initial.surrounding`): for what is far, and what mirrors show. Gaussians have harmonics of
    this `degree`, of which those of degree n learn from step n x `rise` on. They start with this
    `opacity`, and `spread` gaps between points as scale; none gets smaller than `footprint` pixels
    of the camera that sees it most finely.

    Every pixel is seen by `samples` rays over film, lens and exposure (0: 1, and 4 if a camera has
    an aperture or an exposure). `refine` names what of the cameras is learnt too
    (`refinement.REFINABLE`).
    """

    auto: bool = eqx.field(static=True, default=False)
    minutes: float = eqx.field(static=True, default=0.0)
    coarse: int = eqx.field(static=True, default=300)
    fine: int = eqx.field(static=True, default=2500)
    segment: int = eqx.field(static=True, default=0)
    tiles: int = eqx.field(static=True, default=64)
    tile_side: int = eqx.field(static=True, default=8)
    block: int = eqx.field(static=True, default=25)
    validate: float = eqx.field(static=True, default=0.0)
    balance: float = eqx.field(static=True, default=0.5)
    error: float = eqx.field(static=True, default=0.0)
    moving: float = eqx.field(static=True, default=0.6)
    degree: int = eqx.field(static=True, default=0)
    rise: int = eqx.field(static=True, default=0)
    opacity: float = eqx.field(static=True, default=0.9)
    spread: float = eqx.field(static=True, default=0.6)
    points: int = eqx.field(static=True, default=10000)
    surround: float = eqx.field(static=True, default=0.15)
    footprint: float = eqx.field(static=True, default=0.35)
    outliers: float = eqx.field(static=True, default=5.0)
    memory: float = eqx.field(static=True, default=4.0)
    samples: int = eqx.field(static=True, default=0)
    refine: tuple[str, ...] = eqx.field(static=True, default=())
    checkpoint: float = eqx.field(static=True, default=60.0)
    seed: int = eqx.field(static=True, default=0)

    def __check_init__(self):
        for name in ("coarse", "tiles", "tile_side", "block", "points"):
            if getattr(self, name) < 1:
                raise ValueError(f"fit.{name} must be at least 1, got {getattr(self, name)}.")
        for name in (
            *("minutes", "fine", "samples", "checkpoint", "spread", "seed", "rise"),
            *("surround", "footprint", "outliers", "memory"),
        ):
            if getattr(self, name) < 0:
                raise ValueError(f"fit.{name} must be at least 0, got {getattr(self, name)}.")
        for name in ("validate", "balance", "error", "moving", "opacity"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"fit.{name} must be in [0, 1], got {getattr(self, name)}.")
        if len(set(self.refine)) < len(self.refine) or not set(self.refine) <= set(REFINABLE):
            raise ValueError(
                f"fit.refine must name some of {', '.join(REFINABLE)}, each once, got "
                f"{list(self.refine)}."
            )
        if self.segment and self.segment < 2:
            raise ValueError(f"fit.segment must be 0 or at least 2, got {self.segment}.")
        if self.degree not in (0, 1, 2, 3):
            raise ValueError(f"fit.degree must be 0, 1, 2 or 3, got {self.degree}.")


class ReconstructOptions(eqx.Module):
    """All options of `reconstruct`, one class per config group."""

    fit: FitOptions = eqx.field(default_factory=FitOptions)
    track: TrackOptions = eqx.field(default_factory=TrackOptions)
    field: FieldOptions = eqx.field(default_factory=FieldOptions)
    loss: LossOptions = eqx.field(default_factory=LossOptions)
    optimizer: OptimizerOptions = eqx.field(default_factory=OptimizerOptions)
    density: DensityOptions = eqx.field(default_factory=DensityOptions)
    trace: TraceOptions = eqx.field(
        default_factory=lambda: TraceOptions(levels=0, transmittance_min=1e-2)
    )
    need: NeedOptions = eqx.field(default_factory=NeedOptions)
