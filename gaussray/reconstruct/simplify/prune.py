"""What a scene requires: what training rays do not miss is taken away, with what that saves."""

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Float

from gaussray.camera.camera import Camera
from gaussray.reconstruct.data.pictures import Footage
from gaussray.reconstruct.simplify.contribution import Gauge, Look, looks
from gaussray.reconstruct.simplify.draft import (
    Draft,
    begin_draft,
    finish_draft,
    whole_draft,
    with_degree,
    with_steady,
    without_head,
    without_scale,
)
from gaussray.scene.deformation import HEADS, Deformation
from gaussray.scene.scene import Scene
from gaussray.scene.store import PRECISIONS, as_stored
from gaussray.tracer.shard import mesh
from gaussray.tracer.trace import TraceOptions


class NeedOptions(eqx.Module):
    """How little may be missed when a scene is reduced to what it requires.

    Each thing is taken away if that costs at most `loss` dB of PSNR on training rays; 0 takes
    nothing away. The loss is measured on `tiles` tiles of trace.bundle^2 pixels at each of
    `instants` instants; what every Gaussian adds to the pictures, on about `weigh` other tiles.
    The scene is kept in a `precision` of full, every bit, or compact (`scene.compact`).
    """

    loss: float = eqx.field(static=True, default=0.02)
    tiles: int = eqx.field(static=True, default=256)
    instants: int = eqx.field(static=True, default=16)
    weigh: int = eqx.field(static=True, default=8192)
    precision: str = eqx.field(static=True, default="compact")

    def __check_init__(self):
        if not self.loss >= 0:
            raise ValueError(f"need.loss must be at least 0, got {self.loss}.")
        for name in ("tiles", "instants", "weigh"):
            if getattr(self, name) < 1:
                raise ValueError(f"need.{name} must be at least 1, got {getattr(self, name)}.")
        if self.precision not in PRECISIONS:
            raise ValueError(
                f"need.precision must be one of {', '.join(PRECISIONS)}, got {self.precision!r}."
            )


# Is told how many of how many measurements were made, and what the last one was of.
Told = Callable[[int, int, str], None]
# Measurements that halving takes to come within a hundredth.
HALVINGS = 8


class _Trials:
    """What is taken from a draft, one thing after another, and what each costs."""

    def __init__(self, draft: Draft, gauge: Gauge, bound: float, told: Told):
        self.draft, self.gauge, self.bound = draft, gauge, bound
        self._told, self._plan, self._measured = told, _measurements(draft.scene), 0
        self.begin("nothing")
        self.psnr, self.facts = self._cost(draft, "what does nothing"), facts(draft.scene)
        self.steps: list[dict[str, Any]] = []
        self._record("what does nothing", draft, self.psnr, True)

    def take(self, step: str, without: Draft) -> bool:
        """Take one thing away, if that costs little enough."""
        psnr = self._cost(without, step)
        taken = self.psnr - psnr <= self.bound
        self._record(step, without, psnr, taken)
        return taken

    def take_most(self, step: str, count: int, without: Callable[[int], Draft]) -> None:
        """Take away as many of `count` things as cost little enough, to a hundredth of them; the
        cost is taken to grow with their number."""
        low, high, best = 0, count + 1, None
        tried = count
        while count and high - low > max(count // 100, 1):
            draft = without(tried)
            psnr = self._cost(draft, step, least=self.psnr - self.bound)
            if self.psnr - psnr <= self.bound:
                low, best = tried, (draft, psnr)
            else:
                high = tried
            tried = (low + high) // 2
        if best is not None:
            self._record(step, *best, True)

    def begin(self, part: str) -> None:
        """What comes before a part of the plan is over, whether it took all of its measurements."""
        ends = dict(zip(self._plan, itertools.accumulate(self._plan.values()), strict=True))
        self._end = ends[part]
        self._measured = self._end - self._plan[part]

    def _cost(self, draft: Draft, step: str, **how: float) -> float:
        psnr = self.gauge.psnr(draft, **how)
        self._measured = min(self._measured + 1, self._end)
        self._told(self._measured, sum(self._plan.values()), step)
        return psnr

    def _record(self, step: str, draft: Draft, psnr: float, taken: bool) -> None:
        before, after = self.facts, facts(finish_draft(draft))
        changed = {k: [before[k], after[k]] for k in before if before[k] != after[k]}
        lost = round(self.psnr - psnr, 4)
        self.steps.append({"step": step, "taken": taken, "loss": lost, **changed})
        if taken:
            self.draft, self.psnr, self.facts = draft, psnr, after


def _measurements(scene: Scene) -> dict[str, int]:
    """How many are made at most of each part of the way through a scene."""
    degree = {
        name: int(np.sqrt(getattr(scene, name).harmonics.shape[1])) - 1
        for name in ("static", "moving")
    }
    own = facts(scene)
    field = {"rest": HALVINGS, "reduce": own["heads"] + 2 * own["scales"]}
    return {"nothing": 1, "prune": HALVINGS, **field, **degree, "rounding": 1}


def facts(scene: Scene) -> dict[str, int]:
    """What there is of everything in a scene that a fit leaves."""
    degrees = [int(np.sqrt(x.harmonics.shape[1])) - 1 for x in (scene.static, scene.moving)]
    found = {
        "gaussians": scene.count,
        "moving": scene.moving.count,
        **dict.fromkeys(("bodies", "heads", "scales", "rows"), 0),
        "degree": max(degrees),
        "bytes": sum(x.size * x.dtype.itemsize for x in jax.tree.leaves(scene)),
    }
    field = scene.deformation
    if isinstance(field, Deformation):
        found["bodies"] = len(field.bodies.pivot)
        found["heads"] = sum(getattr(field, head) is not None for head in HEADS)
        found["scales"] = len(field.planes.space)
        found["rows"] = sum(plane.shape[1] for plane in field.planes.time)
    return found


def required(
    scene: Scene,
    seen: Footage,
    views: Camera,
    gain: Float[Array, "frames 3"] | None = None,
    *,
    unmet: Bool[np.ndarray, " gaussians"] | None = None,
    options: NeedOptions,
    trace: TraceOptions,
    seed: int,
    keys: int = 1,
    devices: int | None = None,
    told: Told = lambda *_: None,
) -> tuple[Scene, dict[str, Any]]:
    """The scene without what training pictures do not miss, as it is kept, and a report.

    `views` and `gain` are the cameras and the exposures of the pictures as they are by now, `keys`
    the states of the scene across the times of one picture. Of Gaussians that are `unmet` by
    any training ray the pictures say nothing: they stay, for other cameras may see them.
    In this order: the Gaussians that add least to the pictures, the motion of those that change
    least (`begin_draft`), the heads of the field, its scales or the change of their planes in time,
    harmonics of the higher degrees, and the bits that a compact file does not keep. Each is taken
    away if that costs at most `options.loss` dB on the same rays. The report holds the `facts` and
    the PSNR `before` and `after`, every step with its loss in dB and what it changes, taken or not,
    and the `precision` to keep the scene in; of a loss of 0 only that. Every measurement is `told`.
    """
    if not options.loss:
        precision = options.precision
        return as_stored(scene, precision=precision), {"precision": precision}
    sizes = {name: getattr(options, name) for name in ("tiles", "instants", "weigh")}
    some, further = looks(seen, views, gain, **sizes, seed=seed)
    field = scene.deformation
    times = np.zeros(0) if field is None else np.asarray(field.instants)
    draft, change = begin_draft(scene, times)
    trials = _Trials(
        draft, Gauge(some, trace=trace, mesh=mesh(devices), keys=keys), options.loss, told
    )
    report: dict[str, Any] = {"before": facts(scene) | {"psnr": round(trials.psnr, 4)}}
    trials.begin("prune")
    _prune(trials, further, unmet)
    if isinstance(field, Deformation):
        trials.begin("rest")
        _rest(trials, change)
        trials.begin("reduce")
        _reduce(trials, times)
    for part in ("static", "moving"):
        trials.begin(part)
        _lower(trials, part)
    trials.begin("rounding")
    scene = finish_draft(trials.draft)
    stored = as_stored(scene, precision=options.precision)
    precision = options.precision if trials.take("rounding", whole_draft(stored)) else "full"
    scene = stored if precision == options.precision else scene
    report["after"] = facts(scene) | {"psnr": round(trials.psnr, 4)}
    return scene, report | {"steps": trials.steps, "precision": precision}


def _prune(
    trials: _Trials, further: Sequence[Look], unmet: Bool[np.ndarray, " gaussians"] | None
) -> None:
    """Without the Gaussians that add least to the pictures."""
    draft = trials.draft
    order = np.argsort(trials.gauge.weights(draft, further), kind="stable")
    order = order if unmet is None else order[~unmet[order]]

    def without(count: int) -> Draft:
        return eqx.tree_at(lambda d: d.kept, draft, draft.kept.at[order[:count]].set(False))

    trials.take_most("faint Gaussians", len(order), without)


def _rest(trials: _Trials, change: Float[np.ndarray, " moving"]) -> None:
    """With those at rest that change least."""
    draft = trials.draft
    kept = np.flatnonzero(np.asarray(draft.kept)[draft.scene.static.count :])
    order = kept[np.argsort(change[kept], kind="stable")]

    def without(count: int) -> Draft:
        return eqx.tree_at(lambda d: d.resting, draft, draft.resting.at[order[:count]].set(True))

    trials.take_most("slight motion", len(order), without)


def _reduce(trials: _Trials, times: Float[np.ndarray, " instants"]) -> None:
    """Without what the deformation field does not need: heads, scales, change of planes in time."""
    for head in HEADS:
        if trials.facts["heads"]:
            trials.take(f"head {head}", without_head(trials.draft, head))
    for scale in range(facts(trials.draft.scene)["scales"]):
        if trials.facts["scales"] and not trials.take(
            f"scale {scale}", without_scale(trials.draft, scale, times)
        ):
            trials.take(f"change of scale {scale} in time", with_steady(trials.draft, scale))


def _lower(trials: _Trials, part: str) -> None:
    """With harmonics of the lowest degree that will do."""
    coefficients = getattr(trials.draft.scene, part).harmonics.shape[1]
    for degree in range(int(np.sqrt(coefficients)) - 1):
        if trials.take(f"degree above {degree}, {part}", with_degree(trials.draft, part, degree)):
            break


def total(reports: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """What the segments of a clip require together: the report of each, and the sums of what can be
    added up."""
    found: dict[str, Any] = {"segments": list(reports)}
    for when in ("before", "after"):
        if all(when in report for report in reports):
            sums = ("gaussians", "moving", "bytes")
            found[when] = {name: sum(report[when][name] for report in reports) for name in sums}
    return found


def sentence(report: dict[str, Any], name: str = "the scene") -> str:
    """What a report says in one line of a scene of this name, or of all segments together; `file`
    are the bytes of what was written."""
    before, after = report["before"], report["after"]
    field = [
        f"{after[part]} of {before[part]} {noun}"
        for part, noun in (("heads", "heads"), ("scales", "scales of the field"))
        if before.get(part)
    ]
    moving = f"{after['moving']:,} of {before['moving']:,} move"
    if after.get("bodies"):
        moving += f", {after['bodies']} bod{'y' if after['bodies'] == 1 else 'ies'}"
    needs = [f"{after['gaussians']:,} of {before['gaussians']:,} Gaussians ({moving})", *field]
    needs += [f"harmonics of degree {after['degree']}"] if "degree" in after else []
    megabytes = " -> ".join(f"{x / 1e6:.2g}" for x in (before["bytes"], report["file"]))
    gained = f", {after['psnr'] - before['psnr']:+.2f} dB" if "psnr" in after else ""
    return f"{name} needs {', '.join(needs)}: {megabytes} MB{gained}"
