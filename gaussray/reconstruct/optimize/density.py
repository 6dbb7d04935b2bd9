"""Density control between blocks of steps: options, schedule, and the rule of 3DGS.

Clone and split Gaussians where gradients are large and prune faint ones (3DGS, with the statistic
of 3DGRT), on the host; or relocate dead ones (`relocation.py`).
"""

from collections.abc import Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gaussray.geometry import rotation_matrix
from gaussray.reconstruct.optimize.gradient_statistic import GradientStatistic
from gaussray.reconstruct.optimize.relocation import Population, relocate
from gaussray.reconstruct.optimize.rows import EMPTY, occupied, with_rows
from gaussray.reconstruct.optimize.state import ChangedRows, State, with_gaussians
from gaussray.scene.gaussians import Unconstrained


DENSITY_KINDS = ("split", "relocate")
# Share of a kind's rows from which on they are doubled where Gaussians are relocated.
_NEARLY_FULL = 0.9


class DensityOptions(eqx.Module):
    """How the number and the places of the Gaussians change.

    "split" is the adaptive density control of 3DGS: clone, split and prune. "relocate" moves dead
    Gaussians to others and grows to a budget (3DGS as Markov chain Monte Carlo, `relocation.py`).

    Args:
        kind: split or relocate.
        interval: steps between two runs of density control; 0 switches it off (3DGRT: 300).
        start: the first run, as a share of the stage.
        stop: the last run, as a share of the stage.
        threshold: split: mean gradient statistic above which a Gaussian is cloned or split (3DGRT:
            2e-4).
        small: split: the largest scale, in extents, of a Gaussian that is cloned; others are
            split in two (3DGRT: 0.01).
        shrink: split: by how much the halves of a split Gaussian are smaller (3DGRT: 1.6).
        opacity: Gaussians below it are pruned or relocated (3DGRT: 0.005).
        growth: split: the largest number of Gaussians, in initial numbers.
        gaussians: the largest number of Gaussians, if there are not more at first; where they are
            relocated it grows by 5 % each time.
        opacity_cost: relocate: what the mean opacity of all Gaussians costs (MCMC: 0.01). What
            fit.auto chooses falls with the contrast of the pictures (`contrast.cost_at_contrast`).
        scale_cost: relocate: what their mean scale costs, in extents (MCMC: 0.01).
        transient_cost: relocate: how many times these costs a transient Gaussian costs.
        noise: relocate: noise of the positions of faint Gaussians, times covariance over extent; it
            falls like the learning rates.
        free_space: static Gaussians that are nearer to a camera, or to a place midway between two
            neighbouring ones, than this share of the distance of the starting points are removed
            (`free_space.py`); 0: none is.

    Raises:
        ValueError: a value is out of its range.
    """

    kind: str = eqx.field(static=True, default="split")
    interval: int = eqx.field(static=True, default=0)
    start: float = eqx.field(static=True, default=0.15)
    stop: float = eqx.field(static=True, default=0.7)
    threshold: float = eqx.field(static=True, default=2e-4)
    small: float = eqx.field(static=True, default=0.01)
    shrink: float = eqx.field(static=True, default=1.6)
    opacity: float = eqx.field(static=True, default=0.02)
    growth: float = eqx.field(static=True, default=1.5)
    gaussians: int = eqx.field(static=True, default=100000)
    opacity_cost: float = eqx.field(static=True, default=0.01)
    scale_cost: float = eqx.field(static=True, default=0.01)
    transient_cost: float = eqx.field(static=True, default=1.0)
    noise: float = eqx.field(static=True, default=80.0)
    free_space: float = eqx.field(static=True, default=0.5)

    def __check_init__(self):
        if self.kind not in DENSITY_KINDS:
            raise ValueError(
                f"density.kind must be one of {', '.join(DENSITY_KINDS)}, got {self.kind!r}."
            )
        for name in ("opacity_cost", "scale_cost", "transient_cost", "noise"):
            if getattr(self, name) < 0:
                raise ValueError(f"density.{name} must be at least 0, got {getattr(self, name)}.")
        if not 0 <= self.free_space < 1:
            raise ValueError(
                f"density.free_space must be at least 0 and below 1, got {self.free_space}."
            )
        if self.gaussians < 1:
            raise ValueError(f"density.gaussians must be at least 1, got {self.gaussians}.")
        if self.interval < 0:
            raise ValueError(f"density.interval must be at least 0, got {self.interval}.")
        if not 0 <= self.start <= self.stop <= 1:
            raise ValueError(
                "density.start and density.stop must satisfy 0 <= start <= stop <= 1, got "
                f"{self.start} and {self.stop}."
            )
        if self.growth < 1:
            raise ValueError(f"density.growth must be at least 1, got {self.growth}.")
        if self.shrink <= 1:
            raise ValueError(f"density.shrink must be above 1, got {self.shrink}.")

    @property
    def relocates(self) -> bool:
        """Whether dead Gaussians move to live ones, instead of cloning, splitting and pruning."""
        return self.kind == "relocate" and self.interval > 0

    def room(self, count: int) -> int:
        """The largest number of Gaussians that density control makes of `count`."""
        most = max(self.gaussians, count)
        return most if self.relocates else min(int(count * self.growth), most)


def density_due(options: DensityOptions, before: int, done: int, share: float) -> bool:
    """Whether density control runs after a block of steps.

    Args:
        options: interval, and the first and last run.
        before: steps of the stage before the block.
        done: steps of the stage after the block.
        share: share of the stage that is done.
    """
    if not options.interval or not options.start <= share <= options.stop:
        return False
    return done // options.interval != before // options.interval


def relocate_dead(
    state: State,
    *,
    options: DensityOptions,
    limit: int,
    most: Mapping[str, int],
    seed: int,
) -> State:
    """Relocation of dead Gaussians, with one budget for all kinds (`relocation.relocate`). The rows
    of a kind that are nearly full are doubled if the others leave it more of the budget, as far as
    there may be so many of the kind.

    Args:
        state: the state after a block of steps.
        options: `opacity`, below which a Gaussian is dead.
        limit: the largest number of Gaussians of all kinds together.
        most: the largest number of Gaussians of a kind, by its name; others have the budget alone.
        seed: seed of the draws, which differs from call to call.
    """
    parts = {kind: free for kind, free in state.parameters.kinds.items() if len(free.mean)}
    populations = tuple(
        Population(free, getattr(state, f"{kind}_statistic")) for kind, free in parts.items()
    )
    moved = relocate(
        populations,
        jax.random.key(seed),
        opacity=options.opacity,
        limit=jnp.asarray(limit, jnp.int32),
    )
    held = [int(occupied(gaussians).sum()) for gaussians, _ in moved]
    changed = {}
    for kind, (gaussians, fresh), own in zip(parts, moved, held, strict=True):
        rows, room = len(fresh), limit - sum(held) + own
        wanted = 2 * rows
        if kind in most:
            wanted = min(wanted, most[kind])
        if own > _NEARLY_FULL * rows and rows < min(room, wanted):
            rows = wanted
            gaussians = with_rows(gaussians, rows)
        fresh = np.pad(np.asarray(fresh), (0, rows - len(fresh)))
        changed[kind] = ChangedRows(gaussians, fresh)
    return with_gaussians(state, changed)


def clone_split_prune(
    state: State, *, options: DensityOptions, extent: float, limit: tuple[int, int], seed: int
) -> State:
    """The adaptive density control of 3DGS, on static and on moving Gaussians.

    Args:
        state: the state after a block of steps.
        options: the thresholds.
        extent: the scene's length unit (`session.scene_extent`).
        limit: the largest numbers of static and of moving Gaussians.
        seed: seed of the random numbers, which differs from call to call.
    """
    parameters = state.parameters
    static = clone_split_prune_rows(
        parameters.static,
        state.static_statistic,
        options=options,
        extent=extent,
        limit=limit[0],
        seed=2 * seed,
    )
    moving = clone_split_prune_rows(
        parameters.moving,
        state.moving_statistic,
        options=options,
        extent=extent,
        limit=limit[1],
        seed=2 * seed + 1,
    )
    return with_gaussians(state, {"static": static, "moving": moving})


def clone_split_prune_rows(
    gaussians: Unconstrained,
    statistic: GradientStatistic,
    *,
    options: DensityOptions,
    extent: float,
    limit: int,
    seed: int,
) -> ChangedRows:
    """The adaptive density control of 3DGS on one set of Gaussians.

    The Gaussians with the largest statistic come first. New ones take empty rows, then added rows
    (the number of rows doubles when all are full).

    Args:
        gaussians: the Gaussians, in unconstrained values.
        statistic: their gradients since the last density control.
        options: the thresholds.
        extent: the scene's length unit (`session.scene_extent`).
        limit: the largest number of Gaussians.
        seed: seed of the positions of split Gaussians.
    """
    opacity = 1 / (1 + np.exp(-np.asarray(gaussians.logit_opacity, np.float64)))
    kept = occupied(gaussians) & (opacity >= options.opacity)
    strength = np.asarray(statistic.total) / np.maximum(np.asarray(statistic.seen), 1)
    wanted = np.flatnonzero(kept & (strength > options.threshold))
    wanted = wanted[np.argsort(-strength[wanted], kind="stable")][: max(limit - kept.sum(), 0)]
    rows = len(kept)
    if kept.sum() + len(wanted) > rows:
        rows = min(2 * rows, max(limit + limit % 2, rows))
    grown = with_rows(gaussians, rows)
    fresh = np.zeros(rows, bool)
    target = np.flatnonzero(~np.concatenate([kept, np.zeros(rows - len(kept), bool)]))
    target = target[: len(wanted)]
    wanted = wanted[: len(target)]
    array = jax.tree.map(lambda x: np.array(x), grown)
    array.logit_opacity[: len(kept)][~kept] = EMPTY
    for name in ("mean", "quat", "log_scale", "logit_opacity", "harmonics"):
        getattr(array, name)[target] = getattr(array, name)[wanted]
    scale = np.exp(array.log_scale[wanted])
    large = scale.max(axis=1) > options.small * extent
    split, twin = wanted[large], target[large]
    dice = np.random.default_rng(seed)
    # For all rows: a number that changes would compile again.
    turn = np.asarray(rotation_matrix(jnp.asarray(array.quat)))[split]
    center = array.mean[split]
    for half in (split, twin):
        offset = dice.normal(size=(len(split), 3)) * scale[large]
        array.mean[half] = center + np.einsum("nij,nj->ni", turn, offset)
        array.log_scale[half] = np.log(scale[large] / options.shrink)
    fresh[target] = True
    fresh[split] = True
    return ChangedRows(jax.tree.map(jnp.asarray, array), fresh)
