"""Stage 1: multi-view video in, a dynamic scene out."""

import json
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from gaussray.atomic import whole
from gaussray.capture.activity import moved_pixels, point_activity, tile_activity
from gaussray.capture.batches import Footage, Sampler, footage
from gaussray.capture.calibration import Capture, View
from gaussray.dataset.manifest import FrameRecord, write_manifest
from gaussray.devices import agreed, everywhere, leads, wait
from gaussray.fit.course import FitOptions
from gaussray.fit.density import DensityOptions, alive, with_rows
from gaussray.fit.initial import bodies, in_common_view, on_points
from gaussray.fit.journal import Journal, decibel
from gaussray.fit.loss import LossOptions
from gaussray.fit.optimizer import OptimizerOptions, Parameters
from gaussray.fit.state import State, begin_state, refine_state, take
from gaussray.fit.tracking import TrackOptions, track
from gaussray.geometry import rotation_matrix
from gaussray.progress import Progress
from gaussray.requirement import NeedOptions, required, sentence
from gaussray.scene.bodies import Bodies, body_of
from gaussray.scene.deformation import FieldOptions, initial_deformation
from gaussray.scene.gaussians import Gaussians, Unconstrained, constrain, unconstrain
from gaussray.scene.harmonics import C0
from gaussray.scene.planes import initial_planes
from gaussray.scene.scene import Scene
from gaussray.scene.store import save_scene
from gaussray.tracer.shard import mesh_of_hosts
from gaussray.tracer.trace import TraceOptions
from gaussray.tracer.traverse import Capacity
from gaussray.training import StepOptions, Trial, first_trial, train_block


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


def reconstruct(
    capture: Capture,
    out: Path | str,
    *,
    options: ReconstructOptions,
    resume: bool = False,
    devices: int | None = None,
    quiet: bool = False,
) -> Scene:
    """Fit a scene to the training views of a capture and leave it in `out`/scene.npz.

    A coarse stage on the first instant; then the bodies are tracked, and a fine stage with
    deformation fits all instants. The scene that is left and returned is what of it the pictures
    require (`required`), which requirement.json tells and, unless `quiet`, a printed line. `out`
    also gets metrics.jsonl and, at intervals, checkpoint.npz, from which `resume` goes on exactly
    as if nothing had happened. The rays of a step are dealt out
    to so many `devices` (None is all) of every host; the first host alone writes.
    """
    out = Path(out)
    journal = Journal(out, resume=resume, interval=options.fit.checkpoint, writes=leads())
    fit = Fit(capture, journal, options, quiet or not leads(), devices)
    state, stage = journal.resumed() if resume else (fit.begin(), "coarse")
    if stage == "coarse":
        state = fit.run("coarse", state)
        state = fit.with_deformation(state)
    if len(fit.sampler.times) > 1:
        state = fit.run("fine", state)
    scene, report = required(
        finished(state, capture.time_range),
        fit.footage,
        options=options.need,
        trace=options.trace,
        seed=options.fit.seed,
        devices=devices,
    )
    if leads():
        save_scene(out / "scene.npz", scene, info=report, precision=report["precision"])
        write_manifest(
            out / "cameras.json",
            [
                FrameRecord(str(v.image.resolve()), v.camera, v.camera_name, v.split)
                for v in capture.views
            ],
        )
        report["file"] = (out / "scene.npz").stat().st_size
        with whole(out / "requirement.json") as partial:
            partial.write_text(json.dumps(report, indent=2) + "\n")
        journal.checkpoint.unlink(missing_ok=True)
        if not quiet and "steps" in report:
            print(sentence(report))
    wait("reconstructed")
    return scene


class Fit:
    """The host's side of a reconstruction: what is looked at, and in which order.

    Several hosts do the same with the same values; only within `run` are these on all devices.
    """

    def __init__(
        self,
        capture: Capture,
        journal: Journal,
        options: ReconstructOptions,
        quiet: bool,
        devices: int | None = None,
    ):
        views = [view for view in capture.views if view.split == "train"]
        self.capture, self.journal, self.options, self.quiet = capture, journal, options, quiet
        self.step = StepOptions(options.loss, options.optimizer, options.trace)
        self.camera = np.array([view.camera_name for view in views])
        self.footage = footage(views)
        self.moved = moved_pixels(self.footage, self.camera)
        self.extent = _extent(views)
        self.sampler = Sampler(
            self.footage.times,
            tile_activity(self.footage, self.moved, side=options.trace.bundle),
            tiles=options.fit.tiles,
            balance=options.fit.balance,
        )
        self.mesh = mesh_of_hosts(devices)

    def begin(self) -> State:
        """Gaussians on the capture's points, or on random ones; which move is decided at once, so
        that both sets keep their place."""
        fit, points = self.options.fit, self.capture.points
        if points is not None:
            position, color = np.asarray(points.position), np.asarray(points.color)
        else:
            pose = self.footage.camera.trajectory
            origin, axis = np.asarray(pose.translation)[:, 0], _axes_of_view(self.footage)
            position, color = in_common_view(origin, axis, count=fit.points, seed=fit.seed)
        start = on_points(
            position, color, degree=fit.degree, opacity=fit.opacity, spread=fit.spread
        )
        moves = point_activity(self.footage, self.camera, position) > fit.moving
        moves = np.array(agreed(moves))
        if len(self.sampler.times) == 1:
            moves[:] = False
        elif points is None or not self._watched():
            moves[:] = True
        growth = self.options.density.growth
        self.journal.info["limit"] = [int(side.sum() * growth) for side in (~moves, moves)]
        parts = [self._room(take(start, np.flatnonzero(side))) for side in (~moves, moves)]
        return begin_state(Parameters(parts[0], parts[1], None))

    def _watched(self) -> bool:
        """Whether any camera has several frames: only those tell what moves."""
        return len(np.unique(self.camera)) < len(self.camera)

    def _room(self, gaussians: Gaussians) -> Unconstrained:
        """Rows for the Gaussians and for those that density control may add at first."""
        density = self.options.density
        growth = density.growth if density.interval else 1.0
        step = 8 * self.mesh.size
        rows = -(-int(gaussians.count * growth) // step) * step
        return with_rows(unconstrain(gaussians), rows)

    def with_deformation(self, state: State) -> State:
        """The fine stage's start: tracked bodies, and a field that leaves them as they are."""
        parameters, field = state.parameters, self.options.field
        moving = take(parameters.moving, np.flatnonzero(alive(parameters.moving)))
        if not len(moving.mean):
            return begin_state(parameters)
        # Stray points must not stretch the box: beyond it the field continues its border.
        lower, upper = np.quantile(moving.mean, (0.02, 0.98), axis=0).astype(np.float32)
        margin = 0.1 * (upper - lower).max() + 1e-6
        planes_key, network_key = jax.random.split(jax.random.key(self.options.fit.seed))
        planes = initial_planes(
            planes_key,
            jnp.asarray(lower - margin),
            jnp.asarray(upper + margin),
            self.capture.time_range,
            sides=field.sides,
            instants=field.instants or max(len(self.sampler.times), 2),
            channels=field.channels,
        )
        tracked = self._tracked(constrain(moving))
        deformation = initial_deformation(network_key, planes, tracked, width=field.width)
        return begin_state(Parameters(parameters.static, parameters.moving, deformation))

    def _tracked(self, moving: Gaussians) -> Bodies:
        """The bodies among the moving Gaussians, with their poses at all instants.

        Random points say nothing of what belongs together, nor do cameras that looked but once:
        then there are no bodies.
        """
        place, instants = np.asarray(moving.mean), self.sampler.times
        known = self.capture.points is not None and self._watched()
        groups = bodies(place if known else place[:0], instants)
        progress = Progress("track", len(instants) - 1, quiet=self.quiet)
        return track(
            groups,
            np.asarray(body_of(groups, moving.mean)),
            place,
            np.asarray(rotation_matrix(moving.quat))[:, :, 2],
            np.asarray(moving.harmonics[:, 0] * C0 + 0.5),
            np.asarray(self.footage.picture),
            self.moved,
            None if self.footage.mask is None else np.asarray(self.footage.mask),
            self.footage.camera,
            options=self.options.track,
            seed=self.options.fit.seed,
            report=progress.report,
        )

    def run(self, stage: str, state: State) -> State:
        """All steps of a stage, in blocks; between blocks density control, files, progress."""
        fit = self.options.fit
        steps = fit.coarse if stage == "coarse" else fit.fine
        progress = Progress(stage, steps, quiet=self.quiet)
        trial: Trial | None = None
        seen, state = everywhere(self.footage, self.mesh), agreed(state)
        while (done := int(state.step)) < steps:
            size = min(fit.block, steps - done)
            batches = self.batches(stage, done, size)
            trial = trial or self.trial(state, batches)
            # Steps that leave the state anywhere else would compile twice.
            state = everywhere(state, self.mesh)
            block, terms, needed, dropped = train_block(
                state,
                seen,
                everywhere(batches, self.mesh),
                self.extent,
                options=self.step,
                steps=steps,
                trial=trial,
            )
            if int(dropped):
                # Nothing is lost: the block is thrown away and run again with room enough.
                trial = trial.enlarged(needed)
                continue
            self.journal.demand_finite(terms, state, block, stage)
            state = self._densified(stage, block, steps, done)
            self.journal.record(stage, done + size, terms)
            progress.report(done + size, f"{decibel(terms['mse']):.2f} dB")
            self.journal.save_in_time(state, stage)
        return agreed(state)

    def batches(self, stage: str, done: int, size: int):
        """Frames, tiles and times of a block; they depend on seed and step alone."""
        dice = np.random.default_rng([self.options.fit.seed, stage == "fine", done])
        count = len(self.sampler.times) if stage == "fine" else 1
        instant = dice.integers(count, size=size)
        frame, tile = self.sampler.draw(instant, dice)
        time = jnp.asarray(self.sampler.times[instant], self.footage.camera.time.dtype)
        return jnp.asarray(frame), jnp.asarray(tile), time

    def trial(self, state: State, batches) -> Trial:
        """Sizes to compile the steps of a stage for."""
        trace = self.options.trace
        found = first_trial(state, self.footage, batches, trace=trace, mesh=self.mesh).capacity
        *cells, pairs, slots = agreed(np.array([*found.cells, found.pairs, found.slots]))
        return Trial(Capacity(tuple(map(int, cells)), int(pairs), int(slots)), self.mesh)

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


def finished(state: State, time_range: tuple[float, float]) -> Scene:
    """The scene of a fit, without empty rows."""
    p = state.parameters
    static, moving = (
        constrain(take(free, np.flatnonzero(alive(free)))) for free in (p.static, p.moving)
    )
    return Scene(static, moving, p.deformation, jnp.asarray(time_range, static.mean.dtype))


def _extent(views: list[View]) -> float:
    """Half the diagonal of the cameras' bounding box (at least a little): the scene's unit."""
    eye = np.concatenate([np.asarray(view.camera.trajectory.translation) for view in views])
    return max(float(np.linalg.norm(np.ptp(eye, axis=0))) / 2, 1e-3)


def _axes_of_view(footage: Footage) -> Float[np.ndarray, "frames 3"]:
    """Where each frame's camera looks, in the world."""
    quat = footage.camera.trajectory.quat[:, 0]
    return np.asarray(rotation_matrix(quat)[:, :, 2])
