"""What a reconstruction has at hand while it works on one segment of a capture."""

from collections.abc import Hashable
from functools import cached_property, partial

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from gaussray.camera.array import camera_set
from gaussray.camera.camera import Camera
from gaussray.camera.corrections import refined_kinds, refined_views
from gaussray.capture.capture import Capture
from gaussray.capture.points import Points
from gaussray.reconstruct.data.backdrop import backdrop_of
from gaussray.reconstruct.data.held_out_tiles import HoldOut, held_out_tiles
from gaussray.reconstruct.data.loader import GrowingWindow, Loader
from gaussray.reconstruct.data.motion_mask import moved_pixels
from gaussray.reconstruct.data.pictures import stacked
from gaussray.reconstruct.data.segments import Segment, training_views
from gaussray.reconstruct.data.silhouettes import are_silhouettes
from gaussray.reconstruct.data.still_cameras import still_camera_count
from gaussray.reconstruct.data.training_pictures import training_pictures
from gaussray.reconstruct.initialize.appearance import Shown
from gaussray.reconstruct.initialize.initializer import InitialPoints, initial_points
from gaussray.reconstruct.initialize.stereo.uncovered import VIEWS
from gaussray.reconstruct.initialize.stereo.view_sets import first_views
from gaussray.reconstruct.initialize.stereo.visual_hull import outside_hull
from gaussray.reconstruct.log import RunLog
from gaussray.reconstruct.optimize.optimizer import scene_of, transients_of
from gaussray.reconstruct.optimize.rows import occupied, take_rows
from gaussray.reconstruct.optimize.state import State
from gaussray.reconstruct.options import ReconstructOptions
from gaussray.reconstruct.picture_options import options_for_pictures
from gaussray.reconstruct.run_progress import RunProgress
from gaussray.reconstruct.shared_results import SharedResults
from gaussray.runtime.progress import Progress, ProgressReport, say
from gaussray.scene.gaussians import constrain
from gaussray.scene.scene import Scene, key_count
from gaussray.tracer.shard import mesh_of_hosts


# Where control points begin at rest: times that the first steps see at least, and the share of the
# fine stage after which all are seen.
_LEAST_TIMES, _GROWN = 12, 0.6


class Session:
    """What the reconstruction of one segment of a capture works with.

    The cameras are those of all segments: they are refined in the first segment, and the others
    use the result. With several hosts, each holds the same values.

    Args:
        capture: the whole capture.
        log: metrics and checkpoints of the run, whose folder may hold the pictures.
        options: all options.
        quiet: show no progress bars.
        devices: how many devices of every host share the rays of a step; None: all.
        segment: the views and the interval of time; None: the whole capture.
        hold_out: which tiles no step draws; it gets fit.validate and fit.seed.
        shared: what fits of the same pictures have in common; None: there are no others.

    Attributes:
        footage: the training pictures of the segment, evened out, and their cameras.
        equalization: what was evened out; None for nothing.
        names: the names of all training cameras of the capture, sorted.
        extent: the scene's length unit, half the diagonal of the cameras' bounding box.
        cameras: what the training cameras have in common, and which of them took each picture.
        backdrop: sRGB-encoded colour of what is behind everything; None: the pictures show a room.
        silhouettes: whether masks cut a thing out, so that nothing is where they hide.
        activity: where the pictures change.
        shared: what fits of the same pictures have in common.
        held_out: the tiles that no step draws, None if there are none.
        loader: draws the tiles of each step.
        times: the times of the training pictures, sorted.
        is_continuation: whether another segment comes before this one.
        still_first: whether Gaussians that stand still are fitted to the pictures of all times
            first, because only they tell what moves: transient Gaussians or control points shall
            show it, and fewer than two cameras stand still.
        at_rest: whether control points begin at rest, and learn how things move (fit.motion).
    """

    def __init__(
        self,
        capture: Capture,
        log: RunLog,
        options: ReconstructOptions,
        quiet: bool,
        devices: int | None = None,
        segment: Segment | None = None,
        hold_out: HoldOut = held_out_tiles,
        shared: SharedResults | None = None,
    ):
        views = training_views(capture)
        part = segment or Segment(views, capture.time_range)
        self.capture, self.log, self.options, self.quiet = capture, log, options, quiet
        self.name, self.time_range = part.name, part.time_range
        self.is_continuation = part.time_range[0] > capture.time_range[0]
        # Of a part alone, the usual exposure would be another than that of the next one.
        evened_out = options.fit.equalize and part.time_range == capture.time_range
        self.shared = shared or SharedResults()
        self.footage, self.equalization, self.activity = training_pictures(
            part.views,
            options,
            self.shared,
            evened_out=evened_out,
            folder=log.out,
            report=self.progress_bar("read", len(part.views), patience=2.0).report,
        )
        self.silhouettes = options.loss.outside_opacity > 0 and self.shared.once(
            "silhouettes", partial(are_silhouettes, views)
        )
        self.backdrop = None if self.silhouettes else backdrop_of(self.footage)
        options, told = options_for_pictures(
            options, self.footage, self.backdrop, silhouettes=self.silhouettes
        )
        if not quiet and not self.is_continuation:
            for sentence in told:
                # Once, also where trials of options come first.
                self.shared.once(sentence, partial(say, sentence))
        self.options = options
        every = self.footage.camera if len(part.views) == len(views) else stacked(views)
        names, owner = np.unique([view.camera_name for view in views], return_inverse=True)
        eye = np.concatenate([np.asarray(view.camera.trajectory.translation) for view in views])
        self.names, self.extent = names.tolist(), scene_extent(eye, capture.points)
        cameras = camera_set(owner, every, extent=self.extent, refine=options.fit.refine)
        segment_owner = jnp.asarray(np.searchsorted(names, self.footage.name), jnp.int32)
        self.cameras = eqx.tree_at(lambda c: c.owner, cameras, segment_owner)
        held_out = hold_out(self.footage, options.fit.validate, options.fit.seed)
        single = len(np.unique(self.footage.times)) == 1
        fit = options.fit
        soft = not single and (fit.control or (fit.transient and not fit.deforms))
        self.still_first = soft and still_camera_count(self.footage) < 2
        self.at_rest = not single and fit.motion == "from_rest"
        self.held_out = held_out if held_out.any() else None
        self.loader = Loader(
            self.footage,
            self.activity,
            tiles=options.fit.tiles,
            # At a single time nothing moves, whatever cameras that move may show.
            moving_share=0.0 if single else options.fit.moving_share,
            error=options.fit.error_share,
            seed=options.fit.seed,
            held_out=self.held_out,
            window=self._window(),
        )
        self.times = self.loader.sampler.times
        self.mesh = mesh_of_hosts(devices)

    def _window(self) -> GrowingWindow | None:
        """The times that steps see at first: the first one, or, where control points begin at rest,
        a while from it on; around the middle if the first time has a single picture, which says
        nothing of distances. None: all, for Gaussians that stand still at all times."""
        times = np.asarray(self.footage.times)
        first, last = float(times.min()), float(times.max())
        several = int(np.sum(times == times.min())) > 1
        if self.at_rest:
            anchor = first if several or self.is_continuation else (first + last) / 2
            return GrowingWindow(anchor, self.options.fit.window, _LEAST_TIMES, _GROWN)
        return GrowingWindow(first) if several and not self.still_first else None

    @property
    def has_videos(self) -> bool:
        """Whether any camera took several pictures. Only those tell what moves."""
        return len(np.unique(self.footage.viewpoints)) < len(self.footage.viewpoints)

    def outside(self, position: Float[np.ndarray, "places 3"]) -> Bool[np.ndarray, " places"]:
        """Which places are empty because masks cut out what stands still elsewhere; none where
        masks do not tell.

        Args:
            position: the places, in the world.
        """
        if not self.silhouettes or len(self.times) > 1:
            return np.zeros(len(position), bool)
        return outside_hull(first_views(self.footage, VIEWS), position)

    @property
    def shows_times_between(self) -> bool:
        """Whether readouts and exposures show much of the time between two pictures."""
        shown = float(self.cameras.earlier + self.cameras.later)
        return len(self.times) > 1 and shown > 0.5 * float(np.min(np.diff(self.times)))

    @cached_property
    def initial_points(self) -> InitialPoints:
        """The points on which the first Gaussians of the capture stand."""
        seen, window = self.footage, self.loader.window
        if self.at_rest and window is not None:
            # At other times, things are elsewhere.
            times = self.times[window.among(self.times, "coarse", 0, 0.0)]
            seen = seen.part(np.flatnonzero(np.isin(seen.times, times)))
        return self.shared.once(
            ("points", *self.points_key),
            lambda: initial_points(self.capture, seen, self.options.fit, self.progress_report),
        )

    @property
    def points_key(self) -> tuple[Hashable, ...]:
        """The options that `initial_points` depends on."""
        fit = self.options.fit
        seen = fit.window if self.at_rest else None
        return fit.start, fit.points, fit.outliers, fit.deforms, fit.seed, seen

    def progress_bar(self, work: str, total: int, patience: float = 0.0) -> Progress:
        """A progress bar for a piece of work on this segment.

        Args:
            work: name of the work, shown after the segment's.
            total: number of units of the work.
            patience: work shorter than this, in seconds, is not shown.
        """
        name = f"{self.name}: {work}" if self.name else work
        return Progress(name, total, quiet=self.quiet, patience=patience)

    def progress_report(self, work: str, patience: float = 0.0) -> ProgressReport:
        """A function that shows the progress of a piece of work, whose total it is told.

        Args:
            work: name of the work, shown after the segment's.
            patience: work shorter than this, in seconds, is not shown.

        Returns:
            A function of the number of units done, their total, and words about the last one.
        """
        bars: list[Progress] = []

        def report(done: int, total: int, note: str = "") -> None:
            if not bars:
                bars.append(self.progress_bar(work, total, patience))
            bars[0].report(done, note)

        return report

    def resume(self, state: State, progress: RunProgress) -> None:
        """Prepare the session to go on with the state of an interrupted run.

        Args:
            state: the state of the checkpoint.
            progress: the progress of the checkpoint.

        Raises:
            ValueError: the run refined other parameters of the cameras than fit.refine names.
        """
        refined = refined_kinds(state.parameters.corrections)
        if set(refined) != set(self.options.fit.refine):
            raise ValueError(
                f"fit.refine must be {list(refined)}, as in the run that is resumed, got "
                f"{list(self.options.fit.refine)}."
            )
        self.loader.restore(progress.tile_errors)
        if progress.moved is not None:
            self.loader.sampler.see_moved(progress.moved)

    def shown(self, frames: Int[np.ndarray, " frames"]) -> Shown:
        """What tracking reads of some frames."""
        moved = moved_pixels(self.footage, self.activity, frames)
        return Shown(self.footage.pictures(frames), moved, self.footage.masks(frames))

    def key_states(self, state: State) -> int:
        """The number of states of the scene that a step interpolates between: 1 where all rays of a
        step share one time."""
        span = self.cameras.earlier + self.cameras.later
        scene = scene_of(state.parameters, jnp.zeros(2), self.cameras.times)
        return key_count(scene, span) if span > 0 else 1

    def training_cameras(self, state: State) -> tuple[Camera, Float[Array, "frames 3 ..."] | None]:
        """The cameras of the training pictures and their `color_response` as refined so far."""
        known = self.cameras, self.footage.camera, self.cameras.owner
        return eqx.filter_jit(refined_views)(state.parameters.corrections, *known)

    def scene(
        self, state: State, progress: RunProgress
    ) -> tuple[Scene, Bool[np.ndarray, " gaussians"]]:
        """The scene of a state, without empty rows, and which Gaussians no ray has met.

        Those of them that stood on known points stay, for other cameras may see them (unless masks
        cut out all that there is); random ones go. Before the first step of a stage none counts as
        unmet.

        Args:
            state: the state.
            progress: how many Gaussians stood on known points at the start of the segment.

        Returns:
            The scene, and for its static and then its moving Gaussians whether no ray has met them.
        """
        p, second, parts, unmet = state.parameters, state.adam.nu, [], []
        known = (0, 0) if self.silhouettes else progress.initial
        for name, initial in zip(("static", "moving"), known, strict=True):
            gaussians = getattr(p, name)
            # A Gaussian that no ray has met was never moved nor split: it is in its first row.
            blind = ~np.any(np.asarray(getattr(second, name).mean), axis=1) & bool(state.step)
            kept = occupied(gaussians) & ~(blind & (np.arange(len(blind)) >= initial))
            parts.append(constrain(take_rows(gaussians, np.flatnonzero(kept))))
            unmet.append(blind[kept])
        time_range = jnp.asarray(self.time_range, parts[0].mean.dtype)
        transient = None
        if p.transient is not None:
            kept = take_rows(p.transient, np.flatnonzero(occupied(p.transient)))
            transient = transients_of(kept, self.cameras.times)
        scene = Scene(parts[0], parts[1], p.deformation, time_range, transient, shading=p.shading)
        return scene, np.concatenate(unmet)


def scene_extent(eye: Float[np.ndarray, "poses 3"], points: Points | None) -> float:
    """The scene's length unit: half the diagonal of the bounding box of the cameras.

    For cameras that stand still it is a thousandth of their median distance from the points.

    Args:
        eye: positions of the cameras in the world, of all their poses.
        points: the points of the capture; None: their distance counts as 1.
    """
    distance = 1.0
    if points is not None:
        away = np.asarray(points.position, np.float64) - np.mean(eye, axis=0, dtype=np.float64)
        distance = float(np.median(np.linalg.norm(away, axis=1))) or distance
    return max(float(np.linalg.norm(np.ptp(eye, axis=0))) / 2, 1e-3 * distance)
