"""Pruning: remove what the training pictures do not need, and report what that saves."""

from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from gaussray.reconstruct.simplify.candidate import (
    Candidate,
    begin_candidate,
    in_shape_of,
    without_shading,
)
from gaussray.reconstruct.simplify.candidate_meter import CandidateMeter, Tracing
from gaussray.reconstruct.simplify.finished import finished_scene
from gaussray.reconstruct.simplify.removal_steps import (
    lower_degree,
    reduce_field,
    remove_faint,
    remove_hidden,
    remove_motion,
)
from gaussray.reconstruct.simplify.removals import Removals
from gaussray.reconstruct.simplify.summary import part_counts
from gaussray.reconstruct.simplify.tile_views import (
    ChosenTiles,
    TrainingViews,
    one_color_psnr,
    tile_views,
)
from gaussray.runtime.progress import ProgressReport, no_report
from gaussray.scene.deformation import Deformation
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


def pruned_scene(
    scene: Scene,
    views: TrainingViews,
    *,
    options: PruneOptions,
    tracing: Tracing,
    seed: int,
    unmet: Bool[np.ndarray, " gaussians"] | None = None,
    report: ProgressReport = no_report,
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
    removals = Removals(candidate, sizes, meter, options.loss, report)
    scores = {"psnr": removals.psnr, "one_color": one_color}
    before = sizes | {"psnr": round(removals.psnr, 4)}
    _remove_parts(removals, chosen, unmet, change, times)
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


def _remove_parts(
    removals: Removals,
    tiles: ChosenTiles,
    unmet: Bool[np.ndarray, " rows"] | None,
    change: Float[np.ndarray, " moving"],
    times: Float[np.ndarray, " instants"],
) -> None:
    """Remove parts in the order of `pruned_scene`, up to the rounding."""
    scene = removals.candidate.scene
    removals.begin("hidden")
    weight = removals.meter.weights(removals.candidate, tiles.weighed)
    remove_hidden(removals, tiles, weight, unmet)
    removals.begin("prune")
    remove_faint(removals, tiles, weight, unmet)
    removals.begin("shading")
    if scene.shading is not None:
        removals.remove("shadows that pass", without_shading(removals.candidate))
    if isinstance(scene.deformation, Deformation):
        removals.begin("rest")
        remove_motion(removals, change)
        removals.begin("reduce")
        reduce_field(removals, times)
    for part in ("static", "moving"):
        removals.begin(part)
        lower_degree(removals, part)


def _with_spare(
    unmet: Bool[np.ndarray, " gaussians"], static: int, candidate: Candidate
) -> Bool[np.ndarray, " rows"]:
    """`unmet`, of a scene of so many static Gaussians, for all rows of its candidate."""
    scene = candidate.scene
    parts = (unmet[:static], scene.static.count), (unmet[static:], scene.moving.count)
    return np.concatenate([np.pad(own, (0, rows - len(own))) for own, rows in parts])
