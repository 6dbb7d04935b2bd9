"""Transient Gaussians: each lives for a short time and moves along a straight line."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from gaussray.scene.gaussians import Gaussians


class Transients(eqx.Module):
    """Short-lived Gaussians in physical values, a structure of arrays.

    At the time t such a Gaussian is at mean + velocity (t - instant), and its opacity is multiplied
    by the window exp(-s^2 / 2) with s = max(|t - instant| - plateau, 0) / lifetime
    (`squared_age`). With a plateau of 0 that is the Gaussian window of FreeTimeGS (Wang et al.
    2025), with a longer one the flat top of SharpTimeGS: full opacity for `plateau` before and
    after the instant, then a Gaussian flank. Shape and colour stay.

    `mean` (the centre at the Gaussian's own instant), `quat`, `scale`, `opacity` (the largest one)
    and `harmonics` are those of `Gaussians`. `velocity` is in scene units per unit of time;
    `instant`, `lifetime` (the standard deviation of the flank, > 0, infinity allowed) and `plateau`
    (>= 0) are in the capture's unit of time. A fit keeps the lifetime above a floor of about half
    an interval between frames (`constrain_transients`), so that the scene stays opaque between
    two frames, where rolling shutters and motion blur look.
    """

    mean: Float[Array, "transients 3"]
    velocity: Float[Array, "transients 3"]
    quat: Float[Array, "transients 4"]
    scale: Float[Array, "transients 3"]
    opacity: Float[Array, " transients"]
    harmonics: Float[Array, "transients coefficients 3"]
    instant: Float[Array, " transients"]
    lifetime: Float[Array, " transients"]
    plateau: Float[Array, " transients"]

    @property
    def count(self) -> int:
        """How many Gaussians the arrays hold."""
        return self.opacity.shape[0]

    @property
    def gaussians(self) -> Gaussians:
        """Every Gaussian as it is at its own instant, at full opacity."""
        return Gaussians(self.mean, self.quat, self.scale, self.opacity, self.harmonics)


class UnconstrainedTransients(eqx.Module):
    """The same Gaussians in values that an optimiser may change freely."""

    mean: Float[Array, "transients 3"]
    velocity: Float[Array, "transients 3"]
    quat: Float[Array, "transients 4"]
    log_scale: Float[Array, "transients 3"]
    logit_opacity: Float[Array, " transients"]
    harmonics: Float[Array, "transients coefficients 3"]
    instant: Float[Array, " transients"]
    log_lifetime: Float[Array, " transients"]
    plateau: Float[Array, " transients"]


@jax.jit
def constrain_transients(
    free: UnconstrainedTransients, shortest: Float[Array, "*transients"] | float
) -> Transients:
    """Physical values of unconstrained ones.

    scale = exp(log_scale), opacity = sigmoid(logit_opacity), lifetime = shortest +
    exp(log_lifetime), plateau = max(plateau, 0).

    Args:
        free: the unconstrained values.
        shortest: floor of the lifetime, in the capture's unit of time, of all or of each; about
            half the interval between two frames.
    """
    return Transients(
        mean=free.mean,
        velocity=free.velocity,
        quat=free.quat,
        scale=jnp.exp(free.log_scale),
        opacity=jax.nn.sigmoid(free.logit_opacity),
        harmonics=free.harmonics,
        instant=free.instant,
        lifetime=shortest + jnp.exp(free.log_lifetime),
        plateau=jnp.maximum(free.plateau, 0),
    )


@jax.jit
def unconstrain_transients(
    transients: Transients, shortest: Float[Array, "*transients"] | float
) -> UnconstrainedTransients:
    """Inverse of `constrain_transients`.

    Opacity is kept a rounding step away from 0 and 1, and lifetime at least a hundredth above
    `shortest`, so that logit and logarithm are finite.

    Args:
        transients: the physical values.
        shortest: as for `constrain_transients`.
    """
    tiny = jnp.finfo(transients.opacity.dtype).eps
    opacity = jnp.clip(transients.opacity, tiny, 1 - tiny)
    above = jnp.maximum(transients.lifetime - shortest, 0.01 * shortest)
    return UnconstrainedTransients(
        mean=transients.mean,
        velocity=transients.velocity,
        quat=transients.quat,
        log_scale=jnp.log(transients.scale),
        logit_opacity=jnp.log(opacity) - jnp.log1p(-opacity),
        harmonics=transients.harmonics,
        instant=transients.instant,
        log_lifetime=jnp.log(above),
        plateau=transients.plateau,
    )


@jax.jit
def interval_at(
    times: Float[Array, " times"], instant: Float[Array, "*instants"]
) -> Float[Array, "*instants"]:
    """Interval between timestamps at each instant.

    It is the longer of the two intervals beside the nearest timestamp: next to a missing picture,
    the whole gap. It is at most twice the upper quartile of all intervals: what lives throughout a
    long pause would be visible at many timestamps before and after.

    Args:
        times: timestamps, increasing. A single one has intervals of 1.
        instant: times anywhere; beyond the ends the nearest interval counts.
    """
    if len(times) < 2:
        return jnp.ones_like(instant)
    gap = jnp.diff(times)
    longer = jnp.maximum(jnp.concatenate([gap[:1], gap]), jnp.concatenate([gap, gap[-1:]]))
    longer = jnp.minimum(longer, 2 * jnp.quantile(gap, 0.75))
    return longer[jnp.searchsorted(0.5 * (times[1:] + times[:-1]), instant)]


def squared_age(
    age: Float[Array, "*times"],
    rate: Float[Array, "*gaussians"],
    plateau: Float[Array, "*gaussians"],
) -> Float[Array, "*both"]:
    """Squared distance in time, s^2; the window is exp(-s^2 / 2).

    Along a ray it adds to the squared distance in space: alpha = opacity exp(-(q + s^2) / 2), so
    that a transient is an ellipsoid in space and time. Smooth where plateau and flank meet.

    Args:
        age: t - instant.
        rate: 1 / lifetime.
        plateau: half the time of full opacity.
    """
    s = jnp.maximum(jnp.abs(age) - plateau, 0) * rate
    return s * s


def transients_at(transients: Transients, time: Float[Array, ""]) -> Gaussians:
    """The transient Gaussians at a time: moved, with the window multiplied into the opacity.

    Args:
        transients: the Gaussians.
        time: in the capture's unit.
    """
    age = time - transients.instant
    faded = squared_age(age, 1 / transients.lifetime, transients.plateau)
    return Gaussians(
        mean=transients.mean + age[:, None] * transients.velocity,
        quat=transients.quat,
        scale=transients.scale,
        opacity=transients.opacity * jnp.exp(-0.5 * faded),
        harmonics=transients.harmonics,
    )
