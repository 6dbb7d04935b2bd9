"""Stage 1: multi-view video in, a dynamic scene out."""

import json
import time as clock
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Float

from gaussray.capture.activity import moved_pixels, point_activity, tile_activity
from gaussray.capture.batches import Footage, Sampler, footage, tile_rays
from gaussray.capture.calibration import Capture, View
from gaussray.color import srgb_encode
from gaussray.dataset.manifest import FrameRecord, write_manifest
from gaussray.fit import loss as losses, regularizer
from gaussray.fit.checkpoint import load_checkpoint, save_checkpoint
from gaussray.fit.density import DensityOptions, alive, with_rows
from gaussray.fit.initial import bodies, in_common_view, on_points
from gaussray.fit.loss import LossOptions
from gaussray.fit.optimizer import OptimizerOptions, Parameters, descend, rates, scene_of
from gaussray.fit.state import State, advance, begin_state, refine_state, take, watch
from gaussray.fit.tracking import TrackOptions, track
from gaussray.geometry import rotation_matrix
from gaussray.progress import Progress
from gaussray.scene.bodies import Bodies, body_of
from gaussray.scene.deformation import FieldOptions, initial_deformation
from gaussray.scene.gaussians import Gaussians, Unconstrained, constrain, unconstrain
from gaussray.scene.harmonics import C0
from gaussray.scene.planes import initial_planes
from gaussray.scene.scene import Scene, at
from gaussray.scene.store import save_scene
from gaussray.tracer.motion import still
from gaussray.tracer.shard import mesh as device_mesh, trace_sharded
from gaussray.tracer.trace import TraceOptions, enlarge, measure
from gaussray.tracer.traverse import Capacity


class FitOptions(eqx.Module):
    """The course of a reconstruction.

    `coarse` steps on the first instant, without deformation; `fine` steps on all, of which the
    first share `opening` lets one instant after another in. A step sees `tiles` tiles of
    trace.bundle^2 pixels, a share `balance` of them where things move; `recent` is the share of
    steps that look at the newest instant while instants are still being let in. Gaussians whose
    pixels change more than a share `moving` of the time get a deformation. `points` random points
    are the start if the capture has none. A block of `block` steps runs without the host;
    `checkpoint` is the interval in seconds between saved states.
    """

    coarse: int = eqx.field(static=True, default=300)
    fine: int = eqx.field(static=True, default=1200)
    tiles: int = eqx.field(static=True, default=64)
    block: int = eqx.field(static=True, default=25)
    balance: float = eqx.field(static=True, default=0.5)
    opening: float = eqx.field(static=True, default=0.0)
    recent: float = eqx.field(static=True, default=0.6)
    moving: float = eqx.field(static=True, default=0.6)
    degree: int = eqx.field(static=True, default=0)
    opacity: float = eqx.field(static=True, default=0.9)
    spread: float = eqx.field(static=True, default=0.6)
    points: int = eqx.field(static=True, default=10000)
    checkpoint: float = eqx.field(static=True, default=60.0)
    seed: int = eqx.field(static=True, default=0)

    def __check_init__(self):
        for name in ("coarse", "tiles", "block", "points"):
            if getattr(self, name) < 1:
                raise ValueError(f"fit.{name} must be at least 1, got {getattr(self, name)}.")
        for name in ("fine", "checkpoint", "spread", "seed"):
            if getattr(self, name) < 0:
                raise ValueError(f"fit.{name} must be at least 0, got {getattr(self, name)}.")
        for name in ("balance", "opening", "recent", "moving", "opacity"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"fit.{name} must be in [0, 1], got {getattr(self, name)}.")
        if self.degree not in (0, 1, 2, 3):
            raise ValueError(f"fit.degree must be 0, 1, 2 or 3, got {self.degree}.")


class ReconstructOptions(eqx.Module):
    """Everything `reconstruct` can be told, one class per config group."""

    fit: FitOptions = eqx.field(default_factory=FitOptions)
    track: TrackOptions = eqx.field(default_factory=TrackOptions)
    field: FieldOptions = eqx.field(default_factory=FieldOptions)
    loss: LossOptions = eqx.field(default_factory=LossOptions)
    optimizer: OptimizerOptions = eqx.field(default_factory=OptimizerOptions)
    density: DensityOptions = eqx.field(default_factory=DensityOptions)
    trace: TraceOptions = eqx.field(
        default_factory=lambda: TraceOptions(levels=0, group=8, transmittance_min=1e-2)
    )


class NonFiniteLoss(RuntimeError):
    """A term of the loss was not a finite number; the last good state has been written."""


def reconstruct(
    capture: Capture,
    out: Path | str,
    *,
    options: ReconstructOptions,
    resume: bool = False,
    quiet: bool = False,
) -> Scene:
    """Fit a scene to the training views of a capture and leave it in `out`/scene.npz.

    Coarse stage on the first instant, fine stage with deformation on all of them. `out` also gets
    metrics.jsonl and, at intervals, checkpoint.npz, from which `resume` goes on exactly as if
    nothing had happened.
    """
    fit = Fit(capture, Path(out), options, quiet)
    state, stage = fit.resumed() if resume else fit.begin()
    if stage == "coarse":
        state = fit.run("coarse", state)
        state = fit.with_deformation(state)
    if fit.options.fit.fine and fit.moves:
        state = fit.run("fine", state)
    return fit.finish(state)


def loss_of(
    parameters: Parameters, seen: Footage, batch, *, options: ReconstructOptions, trial: "Trial"
):
    """Weighted terms of one step's loss, and what there is to report."""
    frame, tile, time = batch
    rays, truth, weight = tile_rays(seen, frame, tile, side=options.trace.bundle)
    scene = _spread_motion(scene_of(parameters, jnp.zeros(2)), trial.mesh)
    pixels, report = trace_sharded(
        still(at(scene, time)),
        rays,
        options=options.trace,
        capacity=trial.capacity,
        mesh=trial.mesh,
    )
    image = losses.developed(srgb_encode(pixels.color), truth)
    image = jnp.where(weight[:, None] > 0, image, truth)
    terms = losses.terms(image, truth, options=options.loss, side=options.trace.bundle)
    if parameters.deformation is not None:
        terms |= regularizer.terms(parameters.deformation.planes)
    total = sum(getattr(options.loss, name) * term for name, term in terms.items())
    terms["mse"] = jnp.mean((image - truth) ** 2)
    return total, (terms, report, rays.origin)


class Trial(eqx.Module):
    """Static sizes a block of steps is compiled for: list capacities and devices."""

    capacity: Capacity
    mesh: Mesh = eqx.field(static=True)


@eqx.filter_jit
def train_block(state: State, seen: Footage, batches, extent, *, options, steps, trial):
    """A block of steps without the host: the new state, mean terms, list sizes, losses of room."""

    def step(state: State, batch):
        slope = jax.value_and_grad(loss_of, has_aux=True)
        (_, (terms, report, eye)), gradient = slope(
            state.parameters, seen, batch, options=options, trial=trial
        )
        rate = rates(
            state.parameters, state.step, options=options.optimizer, extent=extent, steps=steps
        )
        static, moving = watch(state, gradient, eye)
        parameters, adam = descend(state.parameters, gradient, state.adam, rate)
        state = State(parameters, adam, static, moving, state.step + 1)
        return state, (terms, report.needed, report.dropped)

    state, (terms, needed, dropped) = jax.lax.scan(step, state, batches)
    return state, jax.tree.map(jnp.mean, terms), jnp.max(needed, axis=0), jnp.sum(dropped)


class Fit:
    """The host's side of a reconstruction: footage, schedule, files."""

    def __init__(self, capture: Capture, out: Path, options: ReconstructOptions, quiet: bool):
        self.options, self.out, self.quiet = options, out, quiet
        self.capture = capture
        views = [view for view in capture.views if view.split == "train"]
        self.camera = np.array([view.camera_name for view in views])
        self.footage = footage(views)
        self.extent = _extent(views)
        self.sampler = Sampler(
            self.footage.times,
            tile_activity(self.footage, self.camera, side=options.trace.bundle),
            tiles=options.fit.tiles,
            balance=options.fit.balance,
        )
        self.moves = len(self.sampler.times) > 1
        self.mesh = device_mesh()
        self.limit = (0, 0)
        self.known = 0
        self.began = clock.monotonic()
        try:
            out.mkdir(parents=True, exist_ok=True)
            (out / "metrics.jsonl").open("a").close()
        except OSError as error:
            raise OSError(f"out={out}: cannot be written: {error}") from error

    def begin(self) -> tuple[State, str]:
        """Gaussians on the capture's points, or on random ones; which move is decided at once, so
        that both sets keep their place."""
        fit = self.options.fit
        if (self.out / "checkpoint.npz").exists():
            raise ValueError(
                f"out={self.out} holds an unfinished reconstruction. Add resume=true to go on with "
                "it, or choose another folder."
            )
        points = self.capture.points
        if points is not None:
            position, color = np.asarray(points.position), np.asarray(points.color)
        else:
            pose = self.footage.camera.trajectory
            axis = _axes_of_view(self.footage)
            origin = np.asarray(pose.translation)[:, 0]
            position, color = in_common_view(origin, axis, count=fit.points, seed=fit.seed)
        start = on_points(
            position, color, degree=fit.degree, opacity=fit.opacity, spread=fit.spread
        )
        moves = point_activity(self.footage, self.camera, position) > fit.moving
        if not self.moves:
            moves[:] = False
        elif points is None:
            moves[:] = True
        parts = [self._room(take(start, np.flatnonzero(side))) for side in (~moves, moves)]
        return begin_state(Parameters(parts[0], parts[1], None)), "coarse"

    def _room(self, gaussians: Gaussians) -> Unconstrained:
        """Rows for the Gaussians and for those that density control may add at first."""
        density = self.options.density
        growth = density.growth if density.interval else 1.0
        step = 8 * self.mesh.size
        rows = -(-int(gaussians.count * growth) // step) * step
        return with_rows(unconstrain(gaussians), rows)

    def with_deformation(self, state: State) -> State:
        """The fine stage's start: a field around what moves that leaves it where it is."""
        parameters = state.parameters
        if not self.moves or not alive(parameters.moving).any():
            self.moves = False
            return state
        field = self.options.field
        mean = np.asarray(parameters.moving.mean)[alive(parameters.moving)]
        # Stray points must not stretch the box: beyond it the field continues its border.
        lower, upper = np.quantile(mean, (0.02, 0.98), axis=0).astype(np.float32)
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
        groups = self._tracked(parameters.moving)
        deformation = initial_deformation(network_key, planes, groups, width=field.width)
        return begin_state(Parameters(parameters.static, parameters.moving, deformation))

    def _tracked(self, free: Unconstrained) -> Bodies:
        """The bodies among the moving Gaussians, with their poses at all instants."""
        moving = constrain(take(free, np.flatnonzero(alive(free))))
        place = np.asarray(moving.mean)
        groups = bodies(place, self.sampler.times)
        progress = Progress("track", len(self.sampler.times) - 1, quiet=self.quiet)
        return track(
            groups,
            np.asarray(body_of(groups, moving.mean)),
            place,
            np.asarray(rotation_matrix(moving.quat))[:, :, 2],
            np.asarray(moving.harmonics[:, 0] * C0 + 0.5),
            np.asarray(self.footage.picture),
            moved_pixels(self.footage, self.camera),
            self.footage.camera,
            options=self.options.track,
            seed=self.options.fit.seed,
            report=progress.report,
        )

    def run(self, stage: str, state: State) -> State:
        """All steps of a stage, in blocks; between blocks density control, files, progress."""
        fit, options = self.options.fit, self.options
        steps = fit.coarse if stage == "coarse" else fit.fine
        self._set_limit(state)
        progress = Progress(stage, steps, quiet=self.quiet)
        trial: Trial | None = None
        saved = clock.monotonic()
        if not int(state.step):
            self.known = self._known(stage, 0)
        while (done := int(state.step)) < steps:
            newest = self._known(stage, done)
            for instant in range(self.known + 1, newest + 1):
                parameters = advance(state.parameters, instant)
                state = eqx.tree_at(lambda s: s.parameters, state, parameters)
            self.known = newest
            size = min(fit.block, steps - done)
            batches = self._batches(stage, done, size, newest)
            if trial is None:
                trial = Trial(self._measure(state, batches), self.mesh)
            block, terms, needed, dropped = train_block(
                state, self.footage, batches, self.extent, options=options, steps=steps, trial=trial
            )
            if int(dropped):
                # Nothing was lost: the block is thrown away and run again with room enough.
                capacity = enlarge(trial.capacity, [int(n) for n in needed], headroom=1.5)
                trial = Trial(capacity, self.mesh)
                continue
            self._demand_finite(terms, state, block, stage)
            state = self._densify(stage, block, done, done + size, steps)
            self._record(stage, done + size, terms)
            progress.report(done + size, f"{_decibel(terms['mse']):.2f} dB")
            if clock.monotonic() - saved > fit.checkpoint:
                self._save(state, stage)
                saved = clock.monotonic()
        return state

    def _known(self, stage: str, done: int) -> int:
        """Index of the newest instant that the steps may look at."""
        last = len(self.sampler.times) - 1
        opening = self.options.fit.opening * self.options.fit.fine
        if stage == "coarse":
            return 0
        return last if done >= opening else min(1 + int(done / opening * last), last)

    def _batches(self, stage: str, done: int, size: int, newest: int):
        """Frames, tiles and times of a block; they depend on seed and step alone."""
        fit = self.options.fit
        dice = np.random.default_rng([fit.seed, stage == "fine", done])
        instant = dice.integers(newest + 1, size=size)
        if stage == "fine" and newest < len(self.sampler.times) - 1:
            instant = np.where(dice.random(size) < fit.recent, newest, instant)
        frame, tile = self.sampler.draw(instant, dice)
        dtype = self.footage.camera.time.dtype
        times = jnp.asarray(self.sampler.times[instant], dtype)
        return jnp.asarray(frame), jnp.asarray(tile), times

    def _measure(self, state: State, batches) -> Capacity:
        frame, tile, time = (x[0] for x in batches)
        rays, _, _ = tile_rays(self.footage, frame, tile, side=self.options.trace.bundle)
        part = jax.tree.map(lambda x: x[: -(-x.shape[0] // self.mesh.size)], rays)
        scene = scene_of(state.parameters, jnp.zeros(2))
        motion = still(at(scene, time))
        return measure(motion, part, options=self.options.trace, headroom=2.0)

    def _set_limit(self, state: State) -> None:
        growth = self.options.density.growth
        counts = [alive(x).sum() for x in (state.parameters.static, state.parameters.moving)]
        if self.limit == (0, 0):
            self.limit = (int(counts[0] * growth), int(counts[1] * growth))

    def _densify(self, stage: str, state: State, before: int, done: int, steps: int) -> State:
        density = self.options.density
        if not density.interval or not density.start * steps <= done <= density.stop * steps:
            return state
        if done // density.interval == before // density.interval:
            return state
        seed = self.options.fit.seed + 2 * done + (stage == "fine")
        return refine_state(state, options=density, extent=self.extent, limit=self.limit, seed=seed)

    def _demand_finite(self, terms: dict[str, Array], state: State, block: State, stage: str):
        wrong = [f"loss.{name}" for name, value in terms.items() if not np.isfinite(float(value))]
        # The tracer passes over Gaussians that are not finite, so the loss alone would not tell.
        if not wrong and not _all_finite(block.parameters):
            wrong = ["a parameter"]
        if wrong:
            self._save(state, stage)
            raise NonFiniteLoss(
                f"{wrong[0]} is not finite at step {int(state.step)} of the {stage} stage. The "
                f"state before it is in {self.out}/checkpoint.npz; go on with resume=true and a "
                "smaller optimizer.mean, optimizer.network or optimizer.planes."
            )

    def _record(self, stage: str, step: int, terms: dict[str, Array]) -> None:
        line = {"stage": stage, "step": step, "seconds": round(clock.monotonic() - self.began, 3)}
        line |= {name: float(value) for name, value in terms.items()}
        line["psnr"] = _decibel(terms["mse"])
        with (self.out / "metrics.jsonl").open("a") as file:
            file.write(json.dumps(line) + "\n")

    def _save(self, state: State, stage: str) -> None:
        info = {"stage": stage, "limit": list(self.limit), "moves": self.moves}
        info["known"] = self.known
        save_checkpoint(self.out / "checkpoint.npz", state, info=info)

    def resumed(self) -> tuple[State, str]:
        """The state of an interrupted run, and its stage."""
        path = self.out / "checkpoint.npz"
        if not path.is_file():
            raise FileNotFoundError(
                f"out={self.out}: holds no checkpoint.npz to go on with. Leave out resume=true."
            )
        state, info = load_checkpoint(path)
        self.limit, self.known = tuple(info["limit"]), info["known"]
        self.moves = self.moves and info["moves"]
        return state, info["stage"]

    def finish(self, state: State) -> Scene:
        """The scene without empty rows, on disk; the checkpoint has done its duty."""
        p = state.parameters
        parts = [
            constrain(take(free, np.flatnonzero(alive(free)))) for free in (p.static, p.moving)
        ]
        time_range = jnp.asarray(self.capture.time_range, parts[0].mean.dtype)
        scene = Scene(parts[0], parts[1], p.deformation, time_range)
        save_scene(self.out / "scene.npz", scene)
        write_manifest(
            self.out / "cameras.json",
            [
                FrameRecord(str(v.image.resolve()), v.camera, v.camera_name, v.split)
                for v in self.capture.views
            ],
        )
        (self.out / "checkpoint.npz").unlink(missing_ok=True)
        return scene


@eqx.filter_jit
def _all_finite(tree) -> Array:
    return jnp.all(jnp.stack([jnp.all(jnp.isfinite(x)) for x in jax.tree.leaves(tree)]))


def _spread_motion(scene: Scene, mesh: Mesh) -> Scene:
    """The moving Gaussians dealt out to the devices while they are deformed."""
    if mesh.size == 1 or scene.moving.count % mesh.size:
        return scene
    spread = NamedSharding(mesh, PartitionSpec("rays"))
    moving = jax.tree.map(lambda x: jax.lax.with_sharding_constraint(x, spread), scene.moving)
    return eqx.tree_at(lambda s: s.moving, scene, moving)


def _extent(views: list[View]) -> float:
    """Half the diagonal of the cameras' bounding box (at least a little): the scene's unit."""
    eye = np.concatenate([np.asarray(view.camera.trajectory.translation) for view in views])
    return max(float(np.linalg.norm(np.ptp(eye, axis=0))) / 2, 1e-3)


def _axes_of_view(footage: Footage) -> Float[np.ndarray, "frames 3"]:
    """Where each frame's camera looks, in the world."""
    quat = footage.camera.trajectory.quat[:, 0]
    return np.asarray(rotation_matrix(quat)[:, :, 2])


def _decibel(mse: Array) -> float:
    return -10 * float(np.log10(max(float(mse), 1e-12)))
