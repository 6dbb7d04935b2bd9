"""What pruning tries to remove: Gaussians, motion, parts of the deformation field, harmonics."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from gaussray.reconstruct.simplify.candidate import (
    Candidate,
    with_degree,
    without_change_in_time,
    without_head,
    without_scale,
)
from gaussray.reconstruct.simplify.removals import Removals
from gaussray.reconstruct.simplify.summary import part_counts
from gaussray.reconstruct.simplify.tile_views import ChosenTiles
from gaussray.scene.deformation import HEADS


# Share of its weight that is in pixels that count, below which masks hide a Gaussian.
_HIDDEN = 0.1


def remove_hidden(
    removals: Removals,
    tiles: ChosenTiles,
    weight: Float[np.ndarray, " gaussians"],
    unmet: Bool[np.ndarray, " gaussians"] | None,
) -> None:
    """Remove the Gaussians that masks hide almost wholly, those first of which least is seen: the
    pictures do not tell what they look like, but other cameras would see them.

    Args:
        removals: the removals so far.
        tiles: the tiles of the measurements.
        weight: weight of each Gaussian in the tiles that measure it.
        unmet: Gaussians that no training ray meets, which stay; None if there are none.
    """
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


def remove_faint(
    removals: Removals,
    tiles: ChosenTiles,
    weight: Float[np.ndarray, " gaussians"],
    unmet: Bool[np.ndarray, " gaussians"] | None,
) -> None:
    """Remove the Gaussians that add least to the pictures, of those that were looked at: unless all
    tiles were, one that adds nothing may be in another.

    Args:
        removals: the removals so far.
        tiles: the tiles of the measurements.
        weight: weight of each Gaussian in the tiles that measure it.
        unmet: Gaussians that no training ray meets, which stay; None if there are none.
    """
    candidate = removals.candidate
    order = np.argsort(weight, kind="stable")
    order = order[np.asarray(candidate.kept)[order]]
    order = order if unmet is None else order[~unmet[order]]
    order = order if tiles.complete else order[weight[order] > 0]

    removals.remove_most("faint Gaussians", len(order), _without(candidate, order))


def remove_motion(removals: Removals, change: Float[np.ndarray, " moving"]) -> None:
    """Remove the motion of the Gaussians that change least.

    Args:
        removals: the removals so far.
        change: largest change of each moving Gaussian (`begin_candidate`).
    """
    candidate = removals.candidate
    kept = np.flatnonzero(np.asarray(candidate.kept)[candidate.scene.static.count :])
    order = kept[np.argsort(change[kept], kind="stable")]

    def without(count: int) -> Candidate:
        resting = _changed(candidate.resting, order[:count], True)
        return eqx.tree_at(lambda d: d.resting, candidate, resting)

    removals.remove_most("slight motion", len(order), without)


def reduce_field(removals: Removals, times: Float[np.ndarray, " instants"]) -> None:
    """Remove what the deformation field does not need: heads, scales, change of planes in time.

    Args:
        removals: the removals so far.
        times: instants of the field.
    """
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


def lower_degree(removals: Removals, part: str) -> None:
    """Lower the degree of the harmonics as far as it costs little enough.

    Args:
        removals: the removals so far.
        part: `static` or `moving`.
    """
    coefficients = getattr(removals.candidate.scene, part).harmonics.shape[1]
    for degree in range(int(np.sqrt(coefficients)) - 1):
        if removals.remove(
            f"degree above {degree}, {part}", with_degree(removals.candidate, part, degree)
        ):
            break


def _without(candidate: Candidate, order: Int[np.ndarray, " rows"]) -> Callable[[int], Candidate]:
    """The candidate without the first Gaussians of an order, by their number."""

    def without(count: int) -> Candidate:
        kept = _changed(candidate.kept, order[:count], False)
        return eqx.tree_at(lambda d: d.kept, candidate, kept)

    return without


def _changed(
    mask: Bool[Array, " gaussians"], rows: Int[np.ndarray, " rows"], value: bool
) -> Bool[Array, " gaussians"]:
    """A mask with another value in some rows; on the host, where any number of them is alike."""
    changed = np.array(mask)
    changed[rows] = value
    return jnp.asarray(changed)
