"""Pruning: remove what the training pictures do not need, and report what that saves."""

import itertools
import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from gaussray.reconstruct.simplify.candidate import (
    Candidate,
    begin_candidate,
    in_shape_of,
    with_degree,
    without_change_in_time,
    without_head,
    without_scale,
    without_shading,
)
from gaussray.reconstruct.simplify.finished import finished_scene
from gaussray.reconstruct.simplify.measure import (
    CandidateMeter,
    ChosenTiles,
    Tracing,
    TrainingViews,
    one_color_psnr,
    tile_views,
)
from gaussray.reconstruct.simplify.summary import part_counts
from gaussray.runtime.progress import ProgressReport
from gaussray.scene.deformation import HEADS, Deformation
from gaussray.scene.scene import Scene
from gaussray.scene.spare_rows import with_spare_rows
from gaussray.scene.store import PRECISIONS, as_stored


class PruneOptions(eqx.Module):
    """How much quality pruning may cost.

    Args:
        loss: the largest loss of PSNR in dB, on training rays, for which one thing (the faintest
            Gaussians, one network head, ...) is removed. 0 switches pruning off.
        tiles: ray bundles (trace.bundle^2 pixels each) on which the loss is measured, at each time.
        instants: the number of times, evenly spread, at which the loss is measured. Of fewer times
            more bundles are taken, tiles x instants in all.
        contribution_tiles: further ray bundles, in all, on which the contribution of each Gaussian
            is measured.
        precision: how the scene is saved. `compact` quantises it (`scene.compression`), `full`
            keeps every bit.
    """

    loss: float = eqx.field(static=True, default=0.02)
    tiles: int = eqx.field(static=True, default=256)
    instants: int = eqx.field(static=True, default=16)
    contribution_tiles: int = eqx.field(static=True, default=8192)
    precision: str = eqx.field(static=True, default="compact")

    def __check_init__(self):
        if not self.loss >= 0:
            raise ValueError(f"prune.loss must be at least 0, got {self.loss}.")
        for name in ("tiles", "instants", "contribution_tiles"):
            if getattr(self, name) < 1:
                raise ValueError(f"prune.{name} must be at least 1, got {getattr(self, name)}.")
        if self.precision not in PRECISIONS:
            raise ValueError(
                f"prune.precision must be one of {', '.join(PRECISIONS)}, got {self.precision!r}."
            )


# Measurements that bisection takes to come within a hundredth.
BISECTIONS = 8
# Share of its weight that is in pixels that count, below which masks hide a Gaussian.
_HIDDEN = 0.1


class _Removals:
    """Removes parts from a candidate, a scene of these sizes, one after another, each if it costs
    at most `bound` dB."""

    def __init__(
        self,
        candidate: Candidate,
        sizes: dict[str, int],
        meter: CandidateMeter,
        bound: float,
        report: ProgressReport,
    ):
        self.candidate, self.meter, self.bound, self.sizes = candidate, meter, bound, sizes
        self._report, self._measured = report, 0
        self._plan = _measurements(candidate.scene, masked=meter.masked)
        self.begin("nothing")
        self.psnr = self._cost(candidate, "what does nothing")
        self.steps: list[dict[str, Any]] = []
        self._record("what does nothing", candidate, self.psnr, True)

    def remove(self, step: str, without: Candidate) -> bool:
        """Remove one part, if that costs little enough."""
        psnr = self._cost(without, step)
        removed = self.psnr - psnr <= self.bound
        self._record(step, without, psnr, removed)
        return removed

    def remove_most(self, step: str, count: int, without: Callable[[int], Candidate]) -> None:
        """Remove as many of `count` things as cost little enough, to a hundredth of them, by
        bisection: the cost grows with their number."""
        low, high, best = 0, count + 1, None
        tried = count
        while count and high - low > max(count // 100, 1):
            candidate = without(tried)
            psnr = self._cost(candidate, step, least=self.psnr - self.bound)
            if self.psnr - psnr <= self.bound:
                low, best = tried, (candidate, psnr)
            else:
                high = tried
            tried = (low + high) // 2
        if best is not None:
            self._record(step, *best, True)

    def begin(self, part: str) -> None:
        """Begin a part of the plan; parts before it are over, even if they took fewer
        measurements."""
        ends = dict(zip(self._plan, itertools.accumulate(self._plan.values()), strict=True))
        self._end = ends[part]
        self._measured = self._end - self._plan[part]

    def _cost(self, candidate: Candidate, step: str, least: float = -math.inf) -> float:
        psnr = self.meter.psnr(candidate, least=least)
        self._measured = min(self._measured + 1, self._end)
        self._report(self._measured, sum(self._plan.values()), step)
        return psnr

    def _record(self, step: str, candidate: Candidate, psnr: float, removed: bool) -> None:
        before, after = self.sizes, part_counts(finished_scene(candidate))
        changed = {k: [before[k], after[k]] for k in before if before[k] != after[k]}
        lost = round(self.psnr - psnr, 4)
        self.steps.append({"step": step, "taken": removed, "loss": lost, **changed})
        if removed:
            self.candidate, self.psnr, self.sizes = candidate, psnr, after


def _measurements(scene: Scene, *, masked: bool) -> dict[str, int]:
    """The largest number of measurements in each part of pruning."""
    degree = {
        name: int(np.sqrt(getattr(scene, name).harmonics.shape[1])) - 1
        for name in ("static", "moving")
    }
    sizes = part_counts(scene)
    plan = {"nothing": 1, "hidden": BISECTIONS * masked, "prune": BISECTIONS}
    plan |= {"shading": 1, "rest": BISECTIONS}
    return plan | {"reduce": sizes["heads"] + 2 * sizes["scales"]} | degree | {"rounding": 1}


def pruned_scene(
    scene: Scene,
    views: TrainingViews,
    *,
    options: PruneOptions,
    tracing: Tracing,
    seed: int,
    unmet: Bool[np.ndarray, " gaussians"] | None = None,
    report: ProgressReport = lambda *_: None,
) -> tuple[Scene, dict[str, Any]]:
    """The scene without what its training pictures do not need.

    Parts are removed in this order, each if that costs at most `options.loss` dB on the same rays:
    the Gaussians that masks hide almost wholly, those that add least to the pictures, shadows that
    pass over what stands still, the motion of the Gaussians that change least (`begin_candidate`),
    the heads of the deformation network, the scales of its planes or their change in time,
    harmonics of the higher degrees, and the bits that a compact file does not keep.

    Args:
        scene: what a fit ended with.
        views: the training pictures, cameras and exposures as refined.
        options: how much pruning may cost.
        tracing: how candidates are traced.
        seed: for the choice of tiles.
        unmet: Gaussians that no training ray meets. They stay: other cameras may see them.
        report: called after every measurement, with what it was of.

    Returns:
        The scene as it is saved, and a report: `part_counts` and PSNR `before` and `after`, every
        step with its loss in dB and what it changes, the `precision` of the file, and the PSNR of
        the unpruned scene (`psnr`) and of one colour per camera (`one_color`). With a loss of 0 the
        report holds only the last three.
    """
    precision = options.precision
    chosen = tile_views(
        views,
        tiles=options.tiles,
        instants=options.instants,
        weigh=options.contribution_tiles,
        seed=seed,
    )
    field = scene.deformation
    times = np.zeros(0) if field is None else np.asarray(field.instants)
    candidate, change = begin_candidate(with_spare_rows(scene), times)
    if unmet is not None:
        unmet = _with_spare(unmet, scene.static.count, candidate)
    meter = CandidateMeter(chosen.measured, tracing)
    one_color = one_color_psnr(chosen.measured)
    if not options.loss:
        scores = {"psnr": meter.psnr(candidate), "one_color": one_color}
        return as_stored(scene, precision=precision), scores | {"precision": precision}
    sizes = part_counts(scene)
    removals = _Removals(candidate, sizes, meter, options.loss, report)
    scores = {"psnr": removals.psnr, "one_color": one_color}
    before = sizes | {"psnr": round(removals.psnr, 4)}
    removals.begin("hidden")
    weight = meter.weights(candidate, chosen.weighed)
    _remove_hidden(removals, chosen, weight, unmet)
    removals.begin("prune")
    _remove_faint(removals, chosen, weight, unmet)
    removals.begin("shading")
    if scene.shading is not None:
        removals.remove("shadows that pass", without_shading(removals.candidate))
    if isinstance(field, Deformation):
        removals.begin("rest")
        _remove_motion(removals, change)
        removals.begin("reduce")
        _reduce_field(removals, times)
    for part in ("static", "moving"):
        removals.begin(part)
        _lower_degree(removals, part)
    removals.begin("rounding")
    scene = finished_scene(removals.candidate)
    stored = as_stored(scene, precision=precision)
    if removals.remove("rounding", in_shape_of(removals.candidate, stored)):
        scene = stored
    else:
        precision = "full"
    after = part_counts(scene) | {"psnr": round(removals.psnr, 4)}
    steps = {"before": before, "after": after, "steps": removals.steps}
    return scene, steps | scores | {"precision": precision}


def _without(candidate: Candidate, order: Int[np.ndarray, " rows"]) -> Callable[[int], Candidate]:
    """The candidate without the first Gaussians of an order, by their number."""

    def without(count: int) -> Candidate:
        kept = _changed(candidate.kept, order[:count], False)
        return eqx.tree_at(lambda d: d.kept, candidate, kept)

    return without


def _remove_hidden(
    removals: _Removals,
    tiles: ChosenTiles,
    weight: Float[np.ndarray, " gaussians"],
    unmet: Bool[np.ndarray, " gaussians"] | None,
) -> None:
    """Remove the Gaussians that masks hide almost wholly, those first of which least is seen: the
    pictures do not tell what they look like, but other cameras would see them."""
    if not removals.meter.masked:
        return
    candidate = removals.candidate
    whole = removals.meter.weights(candidate, [view.unmasked() for view in tiles.weighed])
    seen = weight / np.maximum(whole, np.finfo(np.float32).tiny)
    hidden = np.asarray(candidate.kept) & (whole > 0) & (seen < _HIDDEN)
    hidden &= True if unmet is None else ~unmet
    order = np.flatnonzero(hidden)
    order = order[np.argsort(seen[order], kind="stable")]

    removals.remove_most("Gaussians that masks hide", len(order), _without(candidate, order))


def _remove_faint(
    removals: _Removals,
    tiles: ChosenTiles,
    weight: Float[np.ndarray, " gaussians"],
    unmet: Bool[np.ndarray, " gaussians"] | None,
) -> None:
    """Remove the Gaussians that add least to the pictures, of those that were looked at: unless all
    tiles were, one that adds nothing may be in another."""
    candidate = removals.candidate
    order = np.argsort(weight, kind="stable")
    order = order[np.asarray(candidate.kept)[order]]
    order = order if unmet is None else order[~unmet[order]]
    order = order if tiles.complete else order[weight[order] > 0]

    removals.remove_most("faint Gaussians", len(order), _without(candidate, order))


def _with_spare(
    unmet: Bool[np.ndarray, " gaussians"], static: int, candidate: Candidate
) -> Bool[np.ndarray, " rows"]:
    """`unmet`, of a scene of so many static Gaussians, for all rows of its candidate."""
    scene = candidate.scene
    parts = (unmet[:static], scene.static.count), (unmet[static:], scene.moving.count)
    return np.concatenate([np.pad(own, (0, rows - len(own))) for own, rows in parts])


def _changed(
    mask: Bool[Array, " gaussians"], rows: Int[np.ndarray, " rows"], value: bool
) -> Bool[Array, " gaussians"]:
    """A mask with another value in some rows; on the host, where any number of them is alike."""
    changed = np.array(mask)
    changed[rows] = value
    return jnp.asarray(changed)


def _remove_motion(removals: _Removals, change: Float[np.ndarray, " moving"]) -> None:
    """Remove the motion of the Gaussians that change least."""
    candidate = removals.candidate
    kept = np.flatnonzero(np.asarray(candidate.kept)[candidate.scene.static.count :])
    order = kept[np.argsort(change[kept], kind="stable")]

    def without(count: int) -> Candidate:
        resting = _changed(candidate.resting, order[:count], True)
        return eqx.tree_at(lambda d: d.resting, candidate, resting)

    removals.remove_most("slight motion", len(order), without)


def _reduce_field(removals: _Removals, times: Float[np.ndarray, " instants"]) -> None:
    """Remove what the deformation field does not need: heads, scales, change of planes in time."""
    for head in HEADS:
        if removals.sizes["heads"]:
            removals.remove(f"head {head}", without_head(removals.candidate, head))
    for scale in range(part_counts(removals.candidate.scene)["scales"]):
        if removals.sizes["scales"] and not removals.remove(
            f"scale {scale}", without_scale(removals.candidate, scale, times)
        ):
            removals.remove(
                f"change of scale {scale} in time",
                without_change_in_time(removals.candidate, scale),
            )


def _lower_degree(removals: _Removals, part: str) -> None:
    """Lower the degree of the harmonics as far as it costs little enough."""
    coefficients = getattr(removals.candidate.scene, part).harmonics.shape[1]
    for degree in range(int(np.sqrt(coefficients)) - 1):
        if removals.remove(
            f"degree above {degree}, {part}", with_degree(removals.candidate, part, degree)
        ):
            break
