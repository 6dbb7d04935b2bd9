"""The host's side of a reconstruction: what is looked at, and in which order."""

import warnings

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from gaussray.camera.array import camera_set, rays_per_pixel
from gaussray.camera.camera import Camera
from gaussray.camera.corrections import Corrections, no_corrections, refined_kinds, refined_views
from gaussray.capture.errors import CaptureWarning
from gaussray.capture.formats.paired import Capture
from gaussray.capture.points import Points
from gaussray.geometry import rotation_matrix
from gaussray.reconstruct.data.batches import Batch
from gaussray.reconstruct.data.loader import Loader
from gaussray.reconstruct.data.motion_mask import activity, moved_pixels, point_activity
from gaussray.reconstruct.data.pictures import Footage, footage, stacked
from gaussray.reconstruct.data.segments import Segment, training_views
from gaussray.reconstruct.initialize.appearance import Shown
from gaussray.reconstruct.initialize.body_tracking import TrackOptions, track
from gaussray.reconstruct.initialize.from_points import (
    between,
    bodies,
    in_common_view,
    inliers,
    merged,
    on_points,
    surrounding,
)
from gaussray.reconstruct.log import Journal, decibel
from gaussray.reconstruct.optimize.density import DensityOptions, alive, with_rows
from gaussray.reconstruct.optimize.loss import LossOptions
from gaussray.reconstruct.optimize.optimizer import OptimizerOptions, Parameters, scene_of
from gaussray.reconstruct.optimize.state import State, begin_state, refine_state, take
from gaussray.reconstruct.options import FitOptions
from gaussray.reconstruct.simplify.prune import NeedOptions
from gaussray.reconstruct.step import StepOptions, Trial, first_trial, train_block
from gaussray.runtime.devices import agreed, everywhere
from gaussray.runtime.progress import Progress
from gaussray.scene.bodies import Bodies, body_of, pose_at, reaching
from gaussray.scene.deformation import Deformation, FieldOptions, initial_deformation
from gaussray.scene.gaussians import Gaussians, Unconstrained, constrain, folded, unconstrain
from gaussray.scene.harmonics import C0
from gaussray.scene.planes import initial_planes
from gaussray.scene.scene import Scene, at, key_count
from gaussray.tracer.shard import mesh_of_hosts
from gaussray.tracer.trace import TraceOptions
from gaussray.tracer.traverse import Capacity


class ReconstructOptions(eqx.Module):
    """Everything `reconstruct` can be told, one class per config group."""

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


class Fit:
    """The host's side of a reconstruction: what is looked at, and in which order.

    Of a capture's segments it looks at one (None: all of the capture is), but the cameras are those
    of all: what is refined of them is found in the first segment and holds for the others. Several
    hosts do the same with the same values; only within `run` are these on all devices.
    """

    def __init__(
        self,
        capture: Capture,
        journal: Journal,
        options: ReconstructOptions,
        quiet: bool,
        devices: int | None = None,
        segment: Segment | None = None,
    ):
        views = training_views(capture)
        part = segment or Segment(views, capture.time_range)
        self.capture, self.journal, self.options, self.quiet = capture, journal, options, quiet
        self.name, self.time_range = part.name, part.time_range
        self.later = part.time_range[0] > capture.time_range[0]
        self.footage = footage(
            part.views,
            side=max(options.fit.tile_side, options.trace.bundle),
            bundle=options.trace.bundle,
            memory=options.fit.memory,
            folder=journal.out,
            report=self.progress("read", len(part.views), patience=2.0).report,
        )
        every = self.footage.camera if len(part.views) == len(views) else stacked(views)
        names, owner = np.unique([view.camera_name for view in views], return_inverse=True)
        eye = np.concatenate([np.asarray(view.camera.trajectory.translation) for view in views])
        self.names, self.extent = names.tolist(), _extent(eye, capture.points)
        cameras = camera_set(owner, every, extent=self.extent, refine=options.fit.refine)
        own = jnp.asarray(np.searchsorted(names, self.footage.name), jnp.int32)
        self.cameras = eqx.tree_at(lambda c: c.owner, cameras, own)
        self.activity = activity(self.footage)
        self.loader = Loader(
            self.footage,
            self.activity,
            tiles=options.fit.tiles,
            balance=options.fit.balance,
            error=options.fit.error,
            seed=options.fit.seed,
        )
        self.times = self.loader.sampler.times
        self.mesh = mesh_of_hosts(devices)

    def progress(self, work: str, total: int, patience: float = 0.0) -> Progress:
        name = f"{self.name}: {work}" if self.name else work
        return Progress(name, total, quiet=self.quiet, patience=patience)

    def resume(self, state: State) -> State:
        """Go on with the state of an interrupted run."""
        held = refined_kinds(state.parameters.corrections)
        if set(held) != set(self.options.fit.refine):
            raise ValueError(
                f"fit.refine must be {list(held)}, as in the run that is gone on with, got "
                f"{list(self.options.fit.refine)}."
            )
        self.loader.restore(self.journal.notes)
        return state

    def begin(self) -> State:
        """Gaussians on the capture's points, or on random ones; which move is decided at once, so
        that both sets keep their place."""
        fit, points = self.options.fit, self.capture.points
        if points is not None:
            position, color = self._cleaned(points)
            lacking = max(fit.points - len(position), 0) if len(position) else 0
            more = between(position, color, count=lacking, seed=fit.seed)
            position, color = (np.concatenate(x) for x in zip((position, color), more, strict=True))
        else:
            pose = self.footage.camera.trajectory
            origin, axis = np.asarray(pose.translation)[:, 0], _axes_of_view(self.footage)
            position, color = in_common_view(origin, axis, count=fit.points, seed=fit.seed)
        start = on_points(
            position, color, degree=fit.degree, opacity=fit.opacity, spread=fit.spread
        )
        moves = self._moves(position, formed=points is not None)
        given = [int(side.sum()) if points is not None else 0 for side in (~moves, moves)]
        count = round(fit.surround * len(position)) if points is not None else 0
        if count:
            around = surrounding(position, count=count, seed=fit.seed)
            more = on_points(*around, degree=fit.degree, opacity=0.5, flat=1.0)
            start = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), start, more)
            moves = np.concatenate([moves, np.zeros(count, bool)])
        self.journal.info["most"] = int(len(moves) * self.options.density.growth)
        corrections = no_corrections(fit.refine, len(self.names), self.footage.camera)
        return self._started(start, moves, given, corrections)

    def take_over(self, state: State) -> State:
        """The start from what the segment before has `handed_on`: its Gaussians, of which those
        move now whose pixels change now."""
        start = constrain(
            take(state.parameters.static, np.flatnonzero(alive(state.parameters.static)))
        )
        moves = self._moves(np.asarray(start.mean), formed=True)
        given = [int(side.sum()) for side in (~moves, moves)]
        return self._started(start, moves, given, state.parameters.corrections)

    def _started(
        self,
        start: Gaussians,
        moves: Bool[np.ndarray, " gaussians"],
        given: list[int],
        corrections: Corrections | None,
    ) -> State:
        """The state before the first step; of either kind of Gaussians, so many of the first are
        `given`."""
        growth = max(self.journal.info["most"] / max(len(moves), 1), 1.0)
        sides = ~moves, moves
        limit = [int(side.sum() * growth) for side in sides]
        self.journal.info |= {"limit": limit, "given": given}
        parts = [self._room(take(start, np.flatnonzero(side)), growth) for side in sides]
        return begin_state(Parameters(parts[0], parts[1], None, corrections))

    def _moves(
        self, position: Float[np.ndarray, "points 3"], *, formed: bool
    ) -> Bool[np.ndarray, " points"]:
        """Which Gaussians may move: of those that are not `formed` yet, nothing can be told."""
        moves = np.array(agreed(point_activity(self.footage, position) > self.options.fit.moving))
        if len(self.times) == 1:
            moves[:] = False
        elif not formed or not self._watched():
            moves[:] = True
        return moves

    def _cleaned(self, points: Points) -> tuple[np.ndarray, np.ndarray]:
        """Places and colours of the points without duplicates and outliers; says how many went."""
        limit, count = self.options.fit.outliers, len(points.position)
        position, color = merged(np.asarray(points.position), np.asarray(points.color))
        keep = inliers(position, limit) if limit else np.ones(len(position), bool)
        if not keep.all() or len(keep) < count:
            warnings.warn(
                f"of {count} starting points, {count - len(keep)} at the place of another and "
                f"{int((~keep).sum())} far from all others are left out. fit.outliers=0 keeps the "
                "latter.",
                CaptureWarning,
                stacklevel=3,
            )
        return position[keep], color[keep]

    def _watched(self) -> bool:
        """Whether any camera has several frames: only those tell what moves."""
        return len(np.unique(self.footage.name)) < len(self.footage.name)

    def _room(self, gaussians: Gaussians, growth: float) -> Unconstrained:
        """Rows for the Gaussians and for those that density control may add at first."""
        growth = growth if self.options.density.interval else 1.0
        step = 8 * self.mesh.size
        rows = -(-int(gaussians.count * growth) // step) * step
        return with_rows(unconstrain(gaussians), rows)

    def with_deformation(self, state: State) -> State:
        """The fine stage's start: tracked bodies, and a field that leaves them as they are."""
        parameters, field = state.parameters, self.options.field
        moving = take(parameters.moving, np.flatnonzero(alive(parameters.moving)))
        if not len(moving.mean):
            return begin_state(parameters)
        begin, end = self.time_range
        # Stray points must not stretch the box: beyond it the field continues its border.
        lower, upper = np.quantile(moving.mean, (0.02, 0.98), axis=0).astype(np.float32)
        margin = 0.1 * (float((upper - lower).max()) or self.extent)
        planes_key, network_key = jax.random.split(jax.random.key(self.options.fit.seed))
        planes = initial_planes(
            planes_key,
            jnp.asarray(lower - margin),
            jnp.asarray(upper + margin),
            (begin - self.cameras.earlier, end + self.cameras.later),
            sides=field.sides,
            instants=field.instants or max(len(self.times), 2),
            channels=field.channels,
        )
        tracked = self._tracked(constrain(moving))
        deformation = initial_deformation(network_key, planes, tracked, width=field.width)
        return begin_state(
            Parameters(parameters.static, parameters.moving, deformation, parameters.corrections)
        )

    def _tracked(self, moving: Gaussians) -> Bodies:
        """The bodies among the moving Gaussians, with their poses at all instants.

        Random points say nothing of what belongs together, nor do cameras that looked but once:
        then there are no bodies.
        """
        place, instants = np.asarray(moving.mean), self.times
        known = self.capture.points is not None and self._watched()
        held = self.journal.info.get("bodies")
        before = None
        if held:
            pivot, radius = (np.array(held[name], np.float32) for name in ("pivot", "radius"))
            before = pivot.reshape(-1, 3), radius
        groups = bodies(place if known else place[:0], instants, known=before)
        progress = self.progress("track", len(instants) - 1)
        tracked = track(
            groups,
            np.asarray(body_of(groups, moving.mean)),
            place,
            np.asarray(rotation_matrix(moving.quat))[:, :, 2],
            np.asarray(moving.harmonics[:, 0] * C0 + 0.5),
            self._shown,
            self.footage.camera,
            options=self.options.track,
            seed=self.options.fit.seed,
            report=progress.report,
        )
        # A body is found where it is in the middle of a readout.
        half = (self.cameras.earlier + self.cameras.later) / 2
        moment = tracked.time + jnp.asarray(self.cameras.later - half, tracked.time.dtype)
        return reaching(eqx.tree_at(lambda b: b.time, tracked, moment), half, half)

    def _shown(self, frames: Int[np.ndarray, " frames"]) -> Shown:
        """What tracking has to know of some frames."""
        seen = self.footage
        moved = moved_pixels(seen, self.activity, frames)
        return Shown(seen.pictures(frames), moved, seen.masks(frames))

    def run(self, stage: str, state: State) -> State:
        """All steps of a stage, in blocks; between blocks density control, files, progress."""
        fit = self.options.fit
        steps = fit.coarse if stage == "coarse" else fit.fine
        progress = self.progress(stage, steps)
        trial: Trial | None = None
        count = _count(state)
        views, cameras = everywhere((self.footage.camera, self.cameras), self.mesh)
        state = agreed(state)
        for done, batches in self.loader.blocks(stage, int(state.step), steps, fit.block):
            trial = trial or self._noted_trial(stage, state) or self.trial(state, batches)
            # Steps that leave the state anywhere else would compile twice.
            state, looked = everywhere((state, batches), self.mesh)
            while True:
                block, terms, error, needed, dropped = train_block(
                    state,
                    views,
                    looked,
                    cameras,
                    options=self.step(stage),
                    steps=steps,
                    trial=trial,
                )
                if not int(dropped):
                    break
                # Nothing is lost: the block is thrown away and run again with room enough.
                trial = trial.enlarged(needed)
            self.journal.demand_finite(terms, state, block, stage)
            self._note_trial(stage, trial)
            self.loader.tell(batches, np.asarray(error))
            self.journal.notes |= self.loader.notes()
            after = done + len(batches.time)
            state = self._densified(stage, block, steps, done)
            count = count if state is block else _count(state)
            self.journal.record(stage, after, terms, count)
            progress.report(after, f"{decibel(terms['mse']):.2f} dB")
            self.journal.save_in_time(state, stage)
        return agreed(state)

    def trial(self, state: State, batches: Batch) -> Trial:
        """Sizes to compile the steps of a stage for, with room for what density control adds:
        Gaussians that take each other's place are smaller, so lists grow more slowly than their
        number."""
        options, mesh, keys = self.step("fine"), self.mesh, self.keys(state)
        density = self.options.density
        wanted = first_trial(
            state,
            self.footage.camera,
            batches,
            self.cameras,
            options=options,
            mesh=mesh,
            keys=keys,
            growth=density.growth**0.5 if density.interval else 1.0,
        ).capacity
        *cells, pairs, slots = agreed(np.array([*wanted.cells, wanted.pairs, wanted.slots]))
        return Trial(Capacity(tuple(map(int, cells)), int(pairs), int(slots)), mesh, keys)

    def _note_trial(self, stage: str, trial: Trial) -> None:
        held = trial.capacity
        sizes = [*held.cells, held.pairs, held.slots]
        self.journal.info["room"] = {"stage": stage, "devices": self.mesh.size, "sizes": sizes}

    def _noted_trial(self, stage: str, state: State) -> Trial | None:
        """The sizes that an interrupted run was compiled for: it goes on with the same programs.
        None where nothing is noted of this stage, on so many devices."""
        held = self.journal.info.get("room")
        if not isinstance(held, dict) or not int(state.step):
            return None
        sizes, there = held.get("sizes"), (held.get("stage"), held.get("devices"))
        if not isinstance(sizes, list) or len(sizes) != self.options.trace.levels + 3:
            return None
        if there != (stage, self.mesh.size) or not all(type(n) is int and n > 0 for n in sizes):
            return None
        *cells, pairs, slots = sizes
        return Trial(Capacity(tuple(cells), pairs, slots), self.mesh, self.keys(state))

    def step(self, stage: str) -> StepOptions:
        """What the steps of a stage are told. Before the scene moves, cameras are taken as they
        are, but for their exposure: it has not formed yet, and would form around their errors.
        After the first segment they are known."""
        o, refine = self.options, self.options.fit.refine
        if self.later:
            refine = ()
        elif stage == "coarse" and len(self.times) > 1:
            refine = tuple(kind for kind in refine if kind == "exposure")
        samples = o.fit.samples or rays_per_pixel(self.footage.camera)
        told = o.loss, o.optimizer, o.trace, samples, o.fit.footprint, refine
        return StepOptions(*told, formed=self.later)

    def keys(self, state: State) -> int:
        """Key states of the scene across a step: one where all its rays share the time."""
        span = self.cameras.earlier + self.cameras.later
        return key_count(scene_of(state.parameters, jnp.zeros(2)), span) if span > 0 else 1

    def _densified(self, stage: str, state: State, steps: int, before: int) -> State:
        density, done = self.options.density, int(state.step)
        if not density.interval or not density.start * steps <= done <= density.stop * steps:
            return state
        if done // density.interval == before // density.interval:
            return state
        seed = self.options.fit.seed + 2 * done + (stage == "fine")
        limit = tuple(self.journal.info["limit"])
        return refine_state(
            agreed(state), options=density, extent=self.extent, limit=limit, seed=seed
        )

    def training_cameras(self, state: State) -> tuple[Camera, Float[Array, "frames 3"] | None]:
        """The frames' cameras and exposures as they are refined by now."""
        known = self.cameras, self.footage.camera, self.cameras.owner
        return eqx.filter_jit(refined_views)(state.parameters.corrections, *known)

    def scene(self, state: State) -> tuple[Scene, Bool[np.ndarray, " gaussians"]]:
        """What a state stands for, without empty rows, and which Gaussians no ray has met.

        Of these the capture's own stay, for other cameras may see them; random ones go. Before the
        first step of a stage nothing is known of any.
        """
        p, second, sides, blind = state.parameters, state.adam.nu, [], []
        for name, given in zip(("static", "moving"), self.journal.info["given"], strict=True):
            free = getattr(p, name)
            # What was never seen was never moved, nor split: it is in its first row.
            unmet = ~np.any(np.asarray(getattr(second, name).mean), axis=1) & bool(state.step)
            kept = alive(free) & ~(unmet & (np.arange(len(unmet)) >= given))
            sides.append(constrain(take(free, np.flatnonzero(kept))))
            blind.append(unmet[kept])
        time_range = jnp.asarray(self.time_range, sides[0].mean.dtype)
        scene = Scene(sides[0], sides[1], p.deformation, time_range)
        return scene, np.concatenate(blind)

    def handed_on(self, state: State) -> State:
        """What the next segment starts from: all Gaussians as they stand at the instant that both
        share, and the cameras as they were found. It can be kept like any other state; where the
        bodies are then is noted with it."""
        scene, _ = self.scene(state)
        last = jnp.asarray(self.times[-1], scene.time_range.dtype)
        self.journal.info["bodies"] = None
        if isinstance(scene.deformation, Deformation):
            held = scene.deformation.bodies
            pivot = np.asarray(held.pivot + pose_at(held, last)[0])
            told = {"pivot": pivot.tolist(), "radius": np.asarray(held.radius).tolist()}
            self.journal.info["bodies"] = told
        shared = unconstrain(folded(eqx.filter_jit(at)(scene, last)))
        none = jax.tree.map(lambda x: x[:0], shared)
        return begin_state(Parameters(shared, none, None, state.parameters.corrections))


def _count(state: State) -> int:
    """How many Gaussians a state has."""
    parts = state.parameters.static, state.parameters.moving
    return sum(int(alive(part).sum()) for part in parts)


def _extent(eye: Float[np.ndarray, "poses 3"], points: Points | None) -> float:
    """Half the diagonal of the cameras' bounding box, the scene's unit; at least a thousandth of
    the cameras' distance from the points (of 1, without points), for those that stand still."""
    least = 1.0
    if points is not None:
        away = np.asarray(points.position, np.float64) - np.mean(eye, axis=0, dtype=np.float64)
        least = float(np.median(np.linalg.norm(away, axis=1))) or least
    return max(float(np.linalg.norm(np.ptp(eye, axis=0))) / 2, 1e-3 * least)


def _axes_of_view(footage: Footage) -> Float[np.ndarray, "frames 3"]:
    """Where each frame's camera looks, in the world."""
    quat = footage.camera.trajectory.quat[:, 0]
    return np.asarray(rotation_matrix(quat)[:, :, 2])
