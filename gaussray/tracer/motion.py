"""Gaussians at the key times of a frame: between two keys everything moves linearly."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from gaussray.scene.gaussians import Gaussians, axes, whitening


class Motion(eqx.Module):
    """States of the same Gaussians at increasing key times; one key is a scene that stands still.

    Between keys the mean and the axes F = R S are interpolated linearly (second order in the key
    spacing). F, not its inverse, because the support of an interpolated F along any normal n never
    exceeds that of the neighbouring keys: |F(s)^T n| <= (1-s)|F0^T n| + s|F1^T n|. The bound over
    the keys is therefore a bound at every time between them. Before the first and after the last
    key the scene rests.
    """

    time: Float[Array, " keys"]
    gaussians: Gaussians

    @property
    def keys(self) -> int:
        """How many key states there are."""
        return self.time.shape[0]


def still(gaussians: Gaussians) -> Motion:
    """A scene that does not move within the frame."""
    lifted = Gaussians(
        mean=gaussians.mean[None],
        quat=gaussians.quat[None],
        scale=gaussians.scale[None],
        opacity=gaussians.opacity,
        harmonics=gaussians.harmonics,
    )
    return Motion(time=jnp.zeros(1, gaussians.mean.dtype), gaussians=lifted)


def key_weights(key_time: Float[Array, " keys"], time: Float[Array, ""]) -> Float[Array, " keys"]:
    """Share of every key state at a time: the hat functions of linear interpolation; they sum to 1.

    Piecewise linear in `time`, so gradients reach shutter and trigger times.
    """
    if key_time.shape[0] == 1:
        return jnp.ones_like(key_time)
    low, high = key_time[:-1], key_time[1:]
    fraction = jnp.clip((time - low) / (high - low), 0, 1)
    begins = jnp.concatenate([jnp.ones_like(fraction[:1]), fraction])
    ends = jnp.concatenate([fraction, jnp.zeros_like(fraction[:1])])
    return begins - ends


def active_keys(
    key_time: Float[Array, " keys"], earliest: Float[Array, ""], latest: Float[Array, ""]
) -> Array:
    """Which key states have a share in some time of the window [earliest, latest]."""
    infinite = jnp.full_like(key_time[:1], jnp.inf)
    before = jnp.concatenate([-infinite, key_time[:-1]])
    after = jnp.concatenate([key_time[1:], infinite])
    return (before <= latest) & (after >= earliest)


def usable(gaussians: Gaussians) -> Bool[Array, " gaussians"]:
    """Which Gaussians can be traced: all values finite at all keys, and scales whose inverse is."""
    g = gaussians
    per_key = jnp.concatenate([g.mean, g.quat, g.scale, 1 / g.scale], axis=-1)
    fine = jnp.all(jnp.isfinite(per_key), axis=(0, -1)) & jnp.all(g.scale > 0, axis=(0, -1))
    return fine & jnp.isfinite(g.opacity) & jnp.all(jnp.isfinite(g.harmonics), axis=(1, 2))


def table(motion: Motion) -> Float[Array, "rows columns"]:
    """All that shading needs of a Gaussian in one row: frame and mean at each key, opacity, colour.

    A single key stores A = S^-1 R^T (nothing to invert later); several keys store F = R S, whose
    interpolation is inverted per ray. Columns: keys x (9 + 3), opacity, harmonics. A last row, of
    an ordinary Gaussian, is for slots without a hit; Gaussians that are not `usable` become such
    too, so that neither their values nor their gradients spread.
    """
    g = _ordinary(motion.gaussians)
    frame = whitening if motion.keys == 1 else axes
    matrix = frame(g.quat, g.scale)
    state = jnp.concatenate([matrix.reshape(*matrix.shape[:2], 9), g.mean], axis=-1)
    state = jnp.moveaxis(state, 0, 1).reshape(g.count, motion.keys * 12)
    return jnp.concatenate([state, g.opacity[:, None], g.harmonics.reshape(g.count, -1)], axis=1)


def _ordinary(g: Gaussians) -> Gaussians:
    """One more Gaussian, whose values are all 1, which also replaces those that are not usable."""
    fine = jnp.pad(usable(g), (0, 1))

    def replace(x: Array, axis: int) -> Array:
        padding = [(0, 1) if i == axis else (0, 0) for i in range(x.ndim)]
        shape = [-1 if i == axis else 1 for i in range(x.ndim)]
        return jnp.where(fine.reshape(shape), jnp.pad(x, padding), 1)

    return Gaussians(
        mean=replace(g.mean, 1),
        quat=replace(g.quat, 1),
        scale=replace(g.scale, 1),
        opacity=replace(g.opacity, 0),
        harmonics=replace(g.harmonics, 0),
    )


def state_at(
    row: list[Float[Array, "*hits"]], weights: Float[Array, " keys *rays"]
) -> tuple[list[Float[Array, "*both"]], list[Float[Array, "*both"]]]:
    """Gaussians (a row of `table`, column by column) at the times of their rays: the nine entries
    of A, row by row, and the mean."""
    keys = weights.shape[0]
    if keys == 1:
        return [row[i] for i in range(9)], [row[i] for i in range(9, 12)]

    def blend(i: int) -> Array:
        total = weights[0] * row[i]
        for key in range(1, keys):
            total = total + weights[key] * row[12 * key + i]
        return total

    return _inverse([blend(i) for i in range(9)]), [blend(i) for i in range(9, 12)]


def _inverse(f: list[Array]) -> list[Array]:
    """Inverse of a 3x3 matrix by cofactors, accurate for columns of any scale near orthogonality.

    Each column is first divided by its largest entry, so products of three scales never underflow.
    """
    columns = [f[0::3], f[1::3], f[2::3]]
    size = [jnp.maximum(jnp.maximum(jnp.abs(a), jnp.abs(b)), jnp.abs(c)) for a, b, c in columns]
    size = [jax.lax.stop_gradient(jnp.where(s > 0, s, 1)) for s in size]
    u, v, w = ([entry / s for entry in column] for column, s in zip(columns, size, strict=True))
    rows = [_cross(v, w), _cross(w, u), _cross(u, v)]
    determinant = u[0] * rows[0][0] + u[1] * rows[0][1] + u[2] * rows[0][2]
    determinant = jnp.where(determinant == 0, 1, determinant)
    return [entry / (determinant * s) for row, s in zip(rows, size, strict=True) for entry in row]


def _cross(a: list[Array], b: list[Array]) -> list[Array]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
