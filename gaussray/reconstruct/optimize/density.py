"""More Gaussians where the error pulls at them, none where they do nothing (3DGS, 3DGRT).

On the host, between blocks of steps. The arrays keep a fixed number of rows, so nothing recompiles;
rows without a Gaussian have logit opacity DEAD and are never met by a ray.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from gaussray.geometry import rotation_matrix
from gaussray.scene.gaussians import Unconstrained


# Logit of an opacity far below any cut-off.
DEAD = -30.0


class DensityOptions(eqx.Module):
    """When and what to clone, split and prune.

    Every `interval` steps between `start` and `stop` (shares of a stage): Gaussians whose mean
    gradient statistic exceeds `threshold` are cloned if their largest scale is at most `small` x
    extent, else split in two of 1/`shrink` the scale; below `opacity` they are pruned. At most
    `growth` x the first number of Gaussians. `interval = 0` switches density control off.
    """

    interval: int = eqx.field(static=True, default=0)
    start: float = eqx.field(static=True, default=0.15)
    stop: float = eqx.field(static=True, default=0.7)
    threshold: float = eqx.field(static=True, default=2e-4)
    small: float = eqx.field(static=True, default=0.01)
    shrink: float = eqx.field(static=True, default=1.6)
    opacity: float = eqx.field(static=True, default=0.02)
    growth: float = eqx.field(static=True, default=1.5)

    def __check_init__(self):
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


class Pull(eqx.Module):
    """How hard the loss has pulled at each Gaussian: sum of |dL/dmean| x distance / 2 over the
    steps in which it was seen, and their number."""

    total: Float[Array, " gaussians"]
    seen: Float[Array, " gaussians"]


def no_pull(count: int) -> Pull:
    """Nothing seen yet."""
    return Pull(jnp.zeros(count), jnp.zeros(count))


def pulled(
    pull: Pull, gradient: Float[Array, "gaussians 3"], distance: Float[Array, " gaussians"]
) -> Pull:
    """The statistic after one more step (3DGRT): gradient of the 3D mean, times the distance to the
    cameras, halved, so that near and far Gaussians count by what they move on the film."""
    strength = jnp.sqrt(jnp.sum(gradient * gradient, axis=-1))
    return Pull(
        pull.total + 0.5 * strength * distance, pull.seen + (strength > 0).astype(pull.seen.dtype)
    )


def alive(free: Unconstrained) -> Bool[np.ndarray, " gaussians"]:
    """Which rows hold a Gaussian."""
    return np.asarray(free.logit_opacity) > DEAD / 2


def with_rows(free: Unconstrained, rows: int) -> Unconstrained:
    """The same Gaussians in arrays of `rows` rows, the new ones empty."""
    missing = rows - free.logit_opacity.shape[0]
    empty = Unconstrained(
        mean=jnp.zeros((missing, 3)),
        quat=jnp.zeros((missing, 4)).at[:, 0].set(1),
        log_scale=jnp.zeros((missing, 3)),
        logit_opacity=jnp.full(missing, DEAD),
        harmonics=jnp.zeros((missing, *free.harmonics.shape[1:])),
    )
    return jax.tree.map(lambda a, b: jnp.concatenate([a, b.astype(a.dtype)]), free, empty)


def refine(
    free: Unconstrained,
    pull: Pull,
    *,
    options: DensityOptions,
    extent: float,
    limit: int,
    seed: int,
) -> tuple[Unconstrained, Bool[np.ndarray, " rows"]]:
    """Prune, clone and split; also which rows are new, so that their moments start afresh.

    Strongest pull first, while there are rows: empty ones, then rows added (the number of rows
    doubles when full) up to `limit` Gaussians.
    """
    opacity = 1 / (1 + np.exp(-np.asarray(free.logit_opacity, np.float64)))
    lives = alive(free) & (opacity >= options.opacity)
    strength = np.asarray(pull.total) / np.maximum(np.asarray(pull.seen), 1)
    wanted = np.flatnonzero(lives & (strength > options.threshold))
    wanted = wanted[np.argsort(-strength[wanted], kind="stable")][: max(limit - lives.sum(), 0)]
    rows = len(lives)
    if lives.sum() + len(wanted) > rows:
        rows = min(2 * rows, max(limit + limit % 2, rows))
    grown = with_rows(free, rows)
    fresh = np.zeros(rows, bool)
    target = np.flatnonzero(~np.concatenate([lives, np.zeros(rows - len(lives), bool)]))
    target = target[: len(wanted)]
    wanted = wanted[: len(target)]
    array = jax.tree.map(lambda x: np.array(x), grown)
    array.logit_opacity[: len(lives)][~lives] = DEAD
    for name in ("mean", "quat", "log_scale", "logit_opacity", "harmonics"):
        getattr(array, name)[target] = getattr(array, name)[wanted]
    scale = np.exp(array.log_scale[wanted])
    large = scale.max(axis=1) > options.small * extent
    split, twin = wanted[large], target[large]
    dice = np.random.default_rng(seed)
    # Of all rows: another number of them each time would compile each time.
    turn = np.asarray(rotation_matrix(jnp.asarray(array.quat)))[split]
    center = array.mean[split]
    for half in (split, twin):
        offset = dice.normal(size=(len(split), 3)) * scale[large]
        array.mean[half] = center + np.einsum("nij,nj->ni", turn, offset)
        array.log_scale[half] = np.log(scale[large] / options.shrink)
    fresh[target] = True
    fresh[split] = True
    return jax.tree.map(jnp.asarray, array), fresh


def refreshed(moment: Array, fresh: Bool[np.ndarray, " rows"]) -> Array:
    """An optimiser's moment after `refine`: kept where a Gaussian stayed, 0 where one is new."""
    moment = jnp.pad(moment, ((0, len(fresh) - moment.shape[0]),) + ((0, 0),) * (moment.ndim - 1))
    mask = jnp.asarray(fresh).reshape(-1, *(1,) * (moment.ndim - 1))
    return jnp.where(mask, 0, moment)
