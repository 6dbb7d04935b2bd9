"""How far a reconstruction has come, apart from the optimiser's state; saved in checkpoint.npz.

The header of a checkpoint holds it as a block of JSON, whose keys are those of earlier versions.
"""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, Int, UInt16

from gaussray.reconstruct.data.sampler import TileErrorState
from gaussray.reconstruct.optimize.free_space import FreeBalls


# Of one segment: its coarse stage, the hand-over from the segment before, its fine stage.
STAGES = ("coarse", "begin", "fine")


class StageSchedule(eqx.Module):
    """How much of a stage is done at its steps: a `share` at the step `begin`, then steadily more,
    and all after `steps`, which are more than `begin`. Compiled steps get it as arrays."""

    steps: int | Int[Array, ""]
    begin: int | Int[Array, ""] = 0
    share: float | Float[Array, ""] = 0.0

    def share_at(self, step: int | Int[Array, ""]) -> float | Float[Array, ""]:
        """Share of the stage that is done at a step, at least `begin`."""
        left = self.steps - self.begin
        return self.share + (1 - self.share) * (step - self.begin) / left


class KnownBodies(eqx.Module):
    """The rigid bodies of the segment before, where they are at its last instant."""

    pivot: Float[np.ndarray, "bodies 3"]
    radius: Float[np.ndarray, " bodies"]


class SavedSizes(eqx.Module):
    """The static sizes that the steps of a `stage` were compiled for, on so many `devices`; the
    first of them are for so many `levels` of bundles; None: for all, as in earlier versions."""

    stage: str = eqx.field(static=True)
    devices: int = eqx.field(static=True)
    levels: int | None = eqx.field(static=True)
    sizes: tuple[int, ...] = eqx.field(static=True)


class RunProgress(eqx.Module):
    """How far a reconstruction has come, apart from the optimiser's state.

    Args:
        stage: the current stage, one of STAGES.
        segment: the current segment, from 1.
        segments: how many segments the capture is cut into.
        initial: how many static and how many moving Gaussians stood on known points at the start of
            the segment. They are the first rows; they stay even if no ray ever meets them.
        limit: the largest numbers of static and of moving Gaussians that density control may reach.
        most: the largest number of Gaussians of both kinds together, in every segment.
        planned: the schedule of a stage that takes a given time; None until its pace is known.
        bodies: the rigid bodies of the segment before; None in the first segment.
        sizes: what the last block of steps was compiled for; None before the first block.
        tile_errors: the errors that the sampler has seen; None if fit.error_share is 0.
        moved: the moving pixels of every frame and tile, where cameras move; None where the
            temporal medians of cameras that stand still tell them.
        free_space: where no static Gaussian stays; None: they may stand anywhere.
        metrics_bytes: the length of metrics.jsonl when the checkpoint was written.
    """

    stage: str = eqx.field(static=True, default="coarse")
    segment: int = eqx.field(static=True, default=1)
    segments: int = eqx.field(static=True, default=1)
    initial: tuple[int, int] = eqx.field(static=True, default=(0, 0))
    limit: tuple[int, int] = eqx.field(static=True, default=(0, 0))
    most: int = eqx.field(static=True, default=0)
    planned: StageSchedule | None = eqx.field(static=True, default=None)
    bodies: KnownBodies | None = None
    sizes: SavedSizes | None = None
    tile_errors: TileErrorState | None = None
    moved: UInt16[np.ndarray, "frames tiles"] | None = None
    free_space: FreeBalls | None = None
    metrics_bytes: int | None = eqx.field(static=True, default=None)


def progress_to_json(progress: RunProgress) -> dict[str, Any]:
    """All but `tile_errors`, `moved` and `free_space`, which are arrays of the file, as JSON."""
    p = progress
    block: dict[str, Any] = {"stage": p.stage, "most": p.most}
    block |= {"limit": list(p.limit), "given": list(p.initial)}
    if p.planned is not None:
        block["planned"] = [p.planned.steps, p.planned.begin, p.planned.share]
    if p.segments > 1:
        block |= {"segment": p.segment, "segments": p.segments}
    if p.bodies is not None:
        block["bodies"] = {"pivot": p.bodies.pivot.tolist(), "radius": p.bodies.radius.tolist()}
    if p.sizes is not None:
        sizes = list(p.sizes.sizes)
        saved = {"stage": p.sizes.stage, "devices": p.sizes.devices, "levels": p.sizes.levels}
        block["room"] = saved | {"sizes": sizes}
    if p.metrics_bytes is not None:
        block["metrics"] = p.metrics_bytes
    return block


def progress_from_json(block: dict[str, Any], tile_errors: TileErrorState | None) -> RunProgress:
    """The progress that `progress_to_json` wrote.

    Args:
        block: the JSON block of a checkpoint's header.
        tile_errors: the errors that the sampler had seen; None if there are none.

    Raises:
        ValueError: the block does not say what it must, or an entry is not of its kind.
    """
    stage, segment, segments = (block.get(k, 1) for k in ("stage", "segment", "segments"))
    if stage not in STAGES or not _are_counts([segment, segments], 1) or segment > segments:
        raise ValueError("does not say where the fit stopped")
    counts = {key: block.get(key, []) for key in ("limit", "given")}
    for key, value in counts.items():
        if not isinstance(value, list) or len(value) != 2 or not _are_counts(value, 0):
            raise ValueError(f"'{key}' must hold two numbers of Gaussians")
    if not _are_counts([block.get("most")], 0):
        raise ValueError("'most' must be a number of Gaussians")
    metrics = block.get("metrics")
    return RunProgress(
        stage=stage,
        segment=segment,
        segments=segments,
        initial=tuple(counts["given"]),
        limit=tuple(counts["limit"]),
        most=block["most"],
        planned=_course(block.get("planned")),
        bodies=_bodies(block.get("bodies")),
        sizes=_sizes(block.get("room")),
        tile_errors=tile_errors,
        metrics_bytes=metrics if type(metrics) is int else None,
    )


def _course(block: Any) -> StageSchedule | None:
    """A number alone, as earlier versions wrote it, is that of all steps; 0: not known yet."""
    if not block:
        return None
    numbers: Any = block if isinstance(block, list) and len(block) == 3 else (block, 0, 0.0)
    steps, begin, share = numbers
    if not _are_counts([steps], 1) or not _are_counts([begin], 0) or begin >= steps:
        raise ValueError("'planned' must be a number of steps, or the schedule of a stage")
    if not isinstance(share, float) or not 0 <= share <= 1:
        raise ValueError("'planned' must hold a share of the stage from 0 to 1")
    return StageSchedule(steps, begin, share)


def _bodies(block: Any) -> KnownBodies | None:
    if not block:
        return None
    try:
        pivot, radius = (np.array(block[name], np.float32) for name in ("pivot", "radius"))
        pivot = pivot.reshape(-1, 3)
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError("'bodies' must hold pivots and radii") from error
    if radius.shape != pivot.shape[:1]:
        raise ValueError("'bodies' must hold as many radii as pivots")
    return KnownBodies(pivot, radius)


def _sizes(block: Any) -> SavedSizes | None:
    """None where they are not usable: sizes can be measured again."""
    if not isinstance(block, dict):
        return None
    stage, devices, sizes = block.get("stage"), block.get("devices", 0), block.get("sizes")
    levels = block.get("levels")
    if not isinstance(sizes, list) or not _are_counts([devices, *sizes], 1) or stage not in STAGES:
        return None
    if levels is not None and not _are_counts([levels], 0):
        return None
    return SavedSizes(stage, devices, levels, tuple(sizes))


def _are_counts(values: Sequence[Any], least: int) -> bool:
    return all(type(value) is int and value >= least for value in values)
