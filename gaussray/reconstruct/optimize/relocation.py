"""Density control by relocation: 3D Gaussian splatting as Markov chain Monte Carlo.

Kheradmand et al. 2024. The number of rows is fixed. Gaussians that have faded ("dead") are moved to
the place of live ones, drawn in proportion to opacity and error, and the number of Gaussians grows
by a constant factor up to a budget. Whoever is copied becomes fainter and smaller, so that the
copies together look like the original. Noise on the positions of faint Gaussians lets them explore.
All functions are pure, compiled, and deterministic for a key.
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from gaussray.reconstruct.optimize.gradient_statistic import GradientStatistic
from gaussray.reconstruct.optimize.rows import EMPTY, Kind
from gaussray.scene.gaussians import Unconstrained, principal_axes
from gaussray.scene.transient import UnconstrainedTransients


# Copies of one Gaussian in one relocation at most (gsplat: 51).
_COPIES = 51
# Opacity at which the noise is half its largest, and how sharply it falls there (the authors').
_NOISY, _SHARP = 0.005, 100.0
# Below this opacity a Gaussian is dead anyway and costs nothing more.
_FAINT = 1e-3


def _held(free: Unconstrained | UnconstrainedTransients) -> Bool[Array, " rows"]:
    """Which rows hold a Gaussian: `rows.occupied`, compiled."""
    return free.logit_opacity > EMPTY / 2


def shared_by_copies(
    opacity: Float[Array, " rows"], copies: Int[Array, " rows"]
) -> tuple[Float[Array, " rows"], Float[Array, " rows"]]:
    """Opacity of each of N equal Gaussians at one place that together replace one, and the factor
    of their scale.

    N alphas composite to 1 - (1 - a)^N. At the centre that equals the original for
    a = 1 - (1 - o)^(1/N). The picture's total is equal too if the footprint's area is: with
    g = exp(-r^2 / 2), the integral of 1 - (1 - a g)^N over the plane is
    2 pi sum_{k=1}^{N} C(N, k) (-1)^(k+1) a^k / k = 2 pi sum_{i=1}^{N} (1 - (1 - a)^i) / i, against
    2 pi o, so scales are multiplied by the root of o / sum_i (1 - (1 - a)^i) / i. (The paper
    equates integrals along a line; its copies lose up to 14 % of the light.)

    Args:
        opacity: opacity o of each Gaussian that is replaced.
        copies: N, 1 to _COPIES.
    """
    opacity = jnp.clip(opacity, 1e-6, 1 - 1e-6)
    rest = jnp.exp(jnp.log1p(-opacity) / copies)

    def add(i: Int[Array, ""], carry: tuple[Array, Array]) -> tuple[Array, Array]:
        total, power = carry
        power = power * rest
        return total + jnp.where(i <= copies, (1 - power) / i, 0), power

    start = jnp.zeros_like(opacity), jnp.ones_like(opacity)
    total, _ = jax.lax.fori_loop(1, _COPIES + 1, add, start)
    return 1 - rest, jnp.sqrt(opacity / total)


class Population(NamedTuple):
    """The Gaussians of one kind, and the gradient statistic since the last relocation."""

    free: Unconstrained | UnconstrainedTransients
    statistic: GradientStatistic


@eqx.filter_jit
def relocate(
    populations: tuple[Population, ...],
    key: Key[Array, ""],
    *,
    opacity: float,
    limit: Int[Array, ""],
    growth: float = 1.05,
) -> list[tuple[Unconstrained | UnconstrainedTransients, Bool[Array, " rows"]]]:
    """Move dead Gaussians to live ones, and add Gaussians to at most `growth` x their number.

    All kinds of Gaussians share one budget: a dead Gaussian becomes a copy of a live one of any
    kind, so that a scene gets as many of each kind as it needs.

    Args:
        populations: the Gaussians of every kind; the numbers of rows stay.
        key: random key of the draws.
        opacity: at most this opacity is dead.
        limit: the budget: no Gaussians are added beyond it.
        growth: factor by which the number grows.

    Returns:
        The Gaussians of every kind, and which rows have changed: their moments must start again
        from zero.
    """
    frees = [population.free for population in populations]
    held = [_held(free) for free in frees]
    live = [
        here & (jax.nn.sigmoid(free.logit_opacity) > opacity)
        for free, here in zip(frees, held, strict=True)
    ]
    dead = [here & ~alive for here, alive in zip(held, live, strict=True)]
    count = sum(jnp.sum(here) for here in held)
    added = jnp.minimum(jnp.floor(growth * count), limit).astype(jnp.int32) - count
    births = jnp.maximum(added, 0) + sum(jnp.sum(gone) for gone in dead)
    weight = relocation_weights(populations, live)
    total = [jnp.sum(of_kind) for of_kind in weight]
    everything = jnp.maximum(sum(total), 1e-30)
    keys = jax.random.split(key, len(frees))
    return [
        _reborn(
            frees[k],
            _Rows(held[k], live[k], weight[k]),
            keys[k],
            births=jnp.round(births * (total[k] / everything)).astype(jnp.int32),
            opacity=opacity,
        )
        for k in range(len(frees))
    ]


def relocation_weights(populations: tuple[Population, ...], live: list[Array]) -> list[Array]:
    """In proportion to what live Gaussians are drawn: their share of the opacity of all kinds plus
    their share of the error of all kinds.

    The error is the mean gradient statistic over the steps that saw the Gaussian.

    Args:
        populations: the Gaussians of every kind.
        live: which rows of each kind hold a live Gaussian; the others have weight 0.

    Returns:
        One array of rows for every kind.
    """

    def shares(values: list[Array]) -> list[Array]:
        values = [jnp.where(alive, x, 0) for alive, x in zip(live, values, strict=True)]
        total = jnp.maximum(sum(jnp.sum(x) for x in values), 1e-30)
        return [x / total for x in values]

    opacity = shares([jax.nn.sigmoid(p.free.logit_opacity) for p in populations])
    error = shares([p.statistic.total / jnp.maximum(p.statistic.seen, 1) for p in populations])
    return [a + b for a, b in zip(opacity, error, strict=True)]


class _Rows(NamedTuple):
    """Which rows of a kind hold a Gaussian, which of these are live, and in proportion to what live
    ones are drawn."""

    held: Bool[Array, " rows"]
    live: Bool[Array, " rows"]
    weight: Float[Array, " rows"]


def _reborn(free, rows: _Rows, key: Key[Array, ""], *, births: Int[Array, ""], opacity: float):
    """One kind of Gaussians with so many copies in the rows of dead ones, then in empty rows. Dead
    Gaussians that no copy replaces are removed."""
    held, live, weight = rows
    dead = held & ~live
    place = jnp.where(dead, jnp.cumsum(dead), jnp.sum(dead) + jnp.cumsum(~held))
    target = ~live & (place <= births) & jnp.any(live)
    removed = dead & ~target & jnp.any(live)
    level = jnp.cumsum(weight)
    drawn = jax.random.uniform(key, live.shape, level.dtype) * level[-1]
    # Rounding must not lead to a row behind the last live one.
    last = jnp.max(jnp.where(live, jnp.arange(len(live)), 0))
    source = jnp.minimum(jnp.searchsorted(level, drawn, side="right"), last)
    source = jnp.where(target, source, jnp.arange(len(live)))
    copies = jnp.zeros(live.shape, jnp.int32).at[source].add(target.astype(jnp.int32)) + 1
    fresh = target | removed | (copies > 1)
    split, factor = shared_by_copies(
        jax.nn.sigmoid(free.logit_opacity), jnp.minimum(copies, _COPIES)
    )
    # Whoever drops below the threshold by being shared would be dead at once.
    split = jnp.clip(split, opacity, 1 - 1e-6)
    logit = jnp.where(copies > 1, jnp.log(split) - jnp.log1p(-split), free.logit_opacity)
    shrunk = eqx.tree_at(
        lambda f: (f.logit_opacity, f.log_scale),
        free,
        (
            jnp.where(removed, EMPTY, logit),
            free.log_scale + jnp.where(copies > 1, jnp.log(factor), 0)[:, None],
        ),
    )
    return jax.tree.map(lambda x: x[source], shrunk), fresh


def explore(
    free: Kind,
    key: Key[Array, ""],
    *,
    size: float | Float[Array, ""],
    extent: float | Float[Array, ""],
    steps: int = 1,
) -> Kind:
    """Positions with the noise of some steps of Langevin dynamics.

    The noise is normal, stretched by the Gaussian's covariance, and only for what is hardly
    visible: times sigmoid(100 (0.005 - opacity)). No step is longer than the Gaussian's longest
    axis, so that large ones do not leave the scene. The sum of n steps is as one that is larger by
    the square root of n.

    Args:
        free: the Gaussians of one kind.
        key: random key of the noise.
        size: factor of the noise: `DensityOptions.noise`, falling like the learning rates.
        extent: the scene's length unit, by which the covariance is divided.
        steps: how many steps the noise is the sum of.
    """
    opacity = jax.nn.sigmoid(free.logit_opacity)
    faint = jax.nn.sigmoid(_SHARP * (_NOISY - opacity)) * _held(free)
    scale = jnp.exp(free.log_scale)
    frame = principal_axes(free.quat, scale)
    dice = jax.random.normal(key, free.mean.shape, free.mean.dtype)
    along = jnp.sum(frame * dice[:, :, None], axis=1)
    step = size * jnp.sum(frame * along[:, None, :], axis=2) / extent
    length = jnp.sqrt(jnp.sum(step * step, axis=1) + 1e-30)
    held = faint * jnp.minimum(1, jnp.max(scale, axis=1) / length) * steps**0.5
    return eqx.tree_at(lambda f: f.mean, free, free.mean + held[:, None] * step)


class Presence(NamedTuple):
    """The Gaussians of one kind, and how much of the costs they pay.

    Args:
        free: the Gaussians.
        window: how far each is there at the time of a step, in [0, 1]; None: fully.
        factor: how many times the costs of other kinds a Gaussian of this kind costs.
    """

    free: Unconstrained | UnconstrainedTransients
    window: Float[Array, " rows"] | None = None
    factor: float = 1.0


def costs(
    kinds: Sequence[Presence], extent: float | Float[Array, ""]
) -> dict[str, Float[Array, ""]]:
    """Mean opacity and mean scale of the Gaussians, as costs that let what is of no use fade.

    The means are over the Gaussians of all kinds together, so what a Gaussian costs does not depend
    on how few of its kind there are; the `factor` of its kind multiplies it. A transient Gaussian
    costs what its `window` leaves of it.

    Args:
        kinds: the Gaussians of every kind.
        extent: the scene's length unit, in which scales are measured.

    Returns:
        The costs, unweighted, by the names opacity and scale.
    """
    opacity_sum, scale_sum, count = jnp.zeros(()), jnp.zeros(()), jnp.zeros((), jnp.int32)
    for free, window, factor in kinds:
        opacity = jax.nn.sigmoid(free.logit_opacity)
        counts = _held(free) & (opacity > _FAINT)
        share = counts.astype(opacity.dtype)
        if window is not None:
            share = jnp.where(counts & (opacity * window > _FAINT), window, 0)
        scale = jnp.where(share[:, None] > 0, jnp.exp(free.log_scale), 0)
        opacity_sum += factor * jnp.sum(share * opacity)
        scale_sum += factor * jnp.sum(scale)
        count += jnp.sum(counts)
    count = jnp.maximum(count, 1)
    return {"opacity": opacity_sum / count, "scale": scale_sum / (3 * count * extent)}
