"""The options of a reconstruction: one class per group of conf/, put together."""

import equinox as eqx

from gaussray.camera.corrections import REFINABLE
from gaussray.io.validate import check_field_types
from gaussray.reconstruct.initialize.body_tracking import TrackOptions
from gaussray.reconstruct.optimize.density import DensityOptions
from gaussray.reconstruct.optimize.learning_rates import OptimizerOptions
from gaussray.reconstruct.optimize.loss import LossOptions
from gaussray.reconstruct.simplify.prune import PruneOptions
from gaussray.scene.deformation import FieldOptions
from gaussray.tracer.options import TraceOptions


# Which points the first Gaussians stand on: the capture's if there are enough of them, else those
# of stereo as well; the capture's, or random ones if it has none; those of stereo; random ones.
STARTS = ("auto", "given", "stereo", "random")


# What shows what moves: what suits the capture best (without fit.auto, bodies and a field); rigid
# bodies and a deformation field; transient Gaussians; all of these; control points, a deformation
# field and transient Gaussians; control points that begin at rest and a deformation field; nothing,
# since nothing moves.
MOTIONS = ("auto", "deformation", "transient", "both", "control_points", "from_rest", "none")


class FitOptions(eqx.Module):
    """The course of a reconstruction.

    Args:
        auto: choose all that has its default by device and capture (`auto_choice`), as `fit=auto`
            of the command does. False: nothing is chosen, as with `fit=default`.
        minutes: duration of the steps, instead of their numbers `coarse` and `fine`; with `auto`,
            not where these are set or rigid bodies show what moves. 0: with `auto`, 3 on a GPU, 4
            on a CPU, or longer for a large capture; else the numbers of steps.
        coarse: steps on the pictures of the first time, without deformation.
        fine: steps on the pictures of all times.
        segment: the largest number of times in a segment; a longer capture is cut into several.
            Each takes `fine` steps and loads its own pictures. Neighbours share a time, at which
            the later one starts from the earlier one's result. 0: one segment.
        tiles: tiles of pictures in a step.
        tile_side: side of a tile in pixels, a whole number of ray bundles.
        block: steps between two visits of the host, which runs density control and writes files.
        validate: share of the tiles that is held out with `minutes`; the fit ends soon after these
            no longer improve.
        moving_share: share of the tiles that are drawn in proportion to their moving pixels (of
            those that are not drawn by error).
        error_share: share of the tiles that are drawn in proportion to their last errors.
        moving_threshold: a Gaussian may move if its pixels change for more than this share of the
            time.
        degree: degree of the spherical harmonics, 0 to 3 (3DGS: 3).
        degree_interval: harmonics of degree n learn from step n x this on (3DGS: 1000); 0: from the
            start.
        initial_opacity: opacity of the first Gaussians (3DGS: 0.1).
        initial_scale: scale of the first Gaussians, in distances between points (3DGS: 1).
        start: which points the first Gaussians stand on, one of STARTS.
        motion: what shows what moves, one of MOTIONS.
        instants: transient Gaussians start at this many times at most, evenly spread.
        points: random points if there are none; if there are fewer, the rest are put between
            them (`from_points.between`).
        surround: random Gaussians around the points, in numbers of points: for what is far away,
            and for what mirrors show (`from_points.surrounding`); none before what a picture shows,
            nor around what stands before a plain backdrop.
        footprint: the least size of a Gaussian, in pixels of the camera that sees it most finely.
        outliers: points further from their neighbours than usual by more than this many standard
            deviations are left out (`from_points.inliers`). 0 keeps all.
        memory: gigabytes of pictures that are kept in memory; more are kept in a file.
        equalize: even out exposures and light that change over time, where cameras that stand still
            tell (`equalization`); light that changes becomes a part of the scene.
        shading: measure shadows and reflected light that pass over what stands still, where three
            cameras stand still and rigid bodies and a field show what moves
            (`initialize.shadows`); they become a part of the scene.
        window: share of the capture's time that the first steps see where control points begin at
            rest; it grows to all (`loader.GrowingWindow`). 1: all from the start.
        samples: rays per pixel over pixel filter, aperture and exposure. 0: 1, or 4 if a camera has
            an aperture or an exposure time.
        refine: the parameters of the cameras that are learnt too (`corrections.REFINABLE`).
        refine_gain: dB that held-out tiles must gain by a correction for it to be kept
            (`refinement_trial`). Below 0: all corrections are kept, without a trial.
        checkpoint: seconds between two checkpoints.
        seed: seed of all random numbers.

    Raises:
        ValueError: a value is out of its range.
    """

    auto: bool = eqx.field(static=True, default=True)
    minutes: float = eqx.field(static=True, default=0.0)
    coarse: int = eqx.field(static=True, default=300)
    fine: int = eqx.field(static=True, default=2500)
    segment: int = eqx.field(static=True, default=0)
    tiles: int = eqx.field(static=True, default=128)
    tile_side: int = eqx.field(static=True, default=8)
    block: int = eqx.field(static=True, default=25)
    validate: float = eqx.field(static=True, default=0.0)
    moving_share: float = eqx.field(static=True, default=0.5)
    error_share: float = eqx.field(static=True, default=0.0)
    moving_threshold: float = eqx.field(static=True, default=0.6)
    degree: int = eqx.field(static=True, default=0)
    degree_interval: int = eqx.field(static=True, default=0)
    initial_opacity: float = eqx.field(static=True, default=0.9)
    initial_scale: float = eqx.field(static=True, default=0.6)
    start: str = eqx.field(static=True, default="auto")
    motion: str = eqx.field(static=True, default="auto")
    instants: int = eqx.field(static=True, default=30)
    points: int = eqx.field(static=True, default=10000)
    surround: float = eqx.field(static=True, default=0.15)
    footprint: float = eqx.field(static=True, default=0.35)
    outliers: float = eqx.field(static=True, default=5.0)
    memory: float = eqx.field(static=True, default=4.0)
    equalize: bool = eqx.field(static=True, default=True)
    shading: bool = eqx.field(static=True, default=True)
    window: float = eqx.field(static=True, default=0.15)
    samples: int = eqx.field(static=True, default=0)
    refine: tuple[str, ...] = eqx.field(static=True, default=())
    refine_gain: float = eqx.field(static=True, default=0.3)
    checkpoint: float = eqx.field(static=True, default=60.0)
    seed: int = eqx.field(static=True, default=0)

    def __check_init__(self):
        check_field_types("fit", self)
        for name in ("coarse", "tiles", "tile_side", "block", "points", "instants"):
            if getattr(self, name) < 1:
                raise ValueError(f"fit.{name} must be at least 1, got {getattr(self, name)}.")
        for name in (
            *("minutes", "fine", "samples", "checkpoint", "initial_scale", "seed"),
            *("degree_interval", "surround", "footprint", "outliers", "memory"),
        ):
            if getattr(self, name) < 0:
                raise ValueError(f"fit.{name} must be at least 0, got {getattr(self, name)}.")
        for name in (
            *("validate", "moving_share", "error_share", "moving_threshold"),
            *("initial_opacity", "window"),
        ):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"fit.{name} must be in [0, 1], got {getattr(self, name)}.")
        if len(set(self.refine)) < len(self.refine) or not set(self.refine) <= set(REFINABLE):
            raise ValueError(
                f"fit.refine must name some of {', '.join(REFINABLE)}, each once, got "
                f"{list(self.refine)}."
            )
        if self.segment and self.segment < 2:
            raise ValueError(f"fit.segment must be 0 or at least 2, got {self.segment}.")
        if self.start not in STARTS:
            raise ValueError(f"fit.start must be one of {', '.join(STARTS)}, got {self.start!r}.")
        if self.motion not in MOTIONS:
            raise ValueError(
                f"fit.motion must be one of {', '.join(MOTIONS)}, got {self.motion!r}."
            )
        if self.degree not in (0, 1, 2, 3):
            raise ValueError(f"fit.degree must be 0, 1, 2 or 3, got {self.degree}.")

    @property
    def transient(self) -> bool:
        """Whether transient Gaussians show what moves, alone or besides others."""
        return self.motion in ("transient", "both", "control_points")

    @property
    def deforms(self) -> bool:
        """Whether a deformation field shows what moves, with rigid bodies or control points."""
        return self.motion not in ("transient", "none")

    @property
    def control(self) -> bool:
        """Whether Gaussians follow control points."""
        return self.motion == "control_points"


class ReconstructOptions(eqx.Module):
    """All options of `reconstruct`, one class per config group.

    Args:
        fit: steps, tiles, starting points and the model of motion.
        track: the search of the poses of rigid bodies.
        field: sizes of the deformation field.
        loss: weights of the terms of the loss.
        optimizer: learning rates.
        density: how the number and the places of the Gaussians change.
        trace: how the rays of a step are traced.
        prune: what is removed after the last step.
        explicit_keys: full names of keys (`fit.degree`) that fit=auto leaves as they are although
            they have their default; all that differ from it stay in any case. The command line
            fills it; fit=auto adds what it finds set and the pictures might change.
    """

    fit: FitOptions = eqx.field(default_factory=FitOptions)
    track: TrackOptions = eqx.field(default_factory=TrackOptions)
    field: FieldOptions = eqx.field(default_factory=FieldOptions)
    loss: LossOptions = eqx.field(default_factory=LossOptions)
    optimizer: OptimizerOptions = eqx.field(default_factory=OptimizerOptions)
    density: DensityOptions = eqx.field(default_factory=DensityOptions)
    trace: TraceOptions = eqx.field(
        default_factory=lambda: TraceOptions(levels=0, transmittance_min=1e-3)
    )
    prune: PruneOptions = eqx.field(default_factory=PruneOptions)
    explicit_keys: tuple[str, ...] = eqx.field(static=True, default=())
