"""Gaussians at the key times of a frame: between the keys everything moves along parabolas."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from gaussray.scene.gaussians import Gaussians, axes, concatenate, whitening


class Motion(eqx.Module):
    """States of the same Gaussians at increasing key times; one key is a scene that stands still.

    The mean, the axes F = R S and the tint move on an arc of a parabola through every three
    neighbouring keys (0 1 2, then 2 3 4, ...), or on a line between two. That is of third order in
    the key spacing and exact for constant acceleration; a bounce is exact where arcs meet and
    smoothed within one. Before the first and after the last key the scene rests.

    Arcs are blended from control points (`controls`) with weights that are not negative and sum to
    1 (`control_weights`). The support of the blend along any normal n is then at most the largest
    of its control points, n.c + |F^T n| being convex: what bounds them bounds every time of the
    arc. That is why F is blended, not its inverse.

    `rest` are Gaussians without key states that stand still; they come before the others.
    """

    time: Float[Array, " keys"]
    gaussians: Gaussians
    rest: Gaussians | None = None

    @property
    def keys(self) -> int:
        """How many key states there are, and as many control points."""
        return self.time.shape[0]

    def __check_init__(self):
        if self.keys != 2 and self.keys % 2 == 0:
            raise ValueError(
                f"render.keys must be 1, 2 or odd, got {self.keys}: arcs go through three keys and "
                "share their ends."
            )


def still(gaussians: Gaussians) -> Motion:
    """A scene that does not move within the frame."""
    lifted = Gaussians(
        mean=gaussians.mean[None],
        quat=gaussians.quat[None],
        scale=gaussians.scale[None],
        opacity=gaussians.opacity,
        harmonics=gaussians.harmonics,
        tint=None if gaussians.tint is None else gaussians.tint[None],
    )
    return Motion(time=jnp.zeros(1, gaussians.mean.dtype), gaussians=lifted)


def whole(motion: Motion) -> Motion:
    """The same with the resting Gaussians repeated at every key."""
    if motion.rest is None:
        return motion
    return Motion(motion.time, concatenate(motion.rest, motion.gaussians))


def controls(
    motion: Motion,
) -> tuple[Float[Array, "keys gaussians 3"], Float[Array, "keys gaussians 3 3"]]:
    """Mean and axes F of the control points: the ends of the arcs, and between them the inner ones.

    An arc meets its middle key M at the fraction f of its time, so its inner control point is
    (M - (1-f)^2 A - f^2 B) / (2 f (1-f)): 2 M - (A + B) / 2 in the middle of the ends A and B.
    """
    g = motion.gaussians
    return _controls(motion.time, g.mean), _controls(motion.time, axes(g.quat, g.scale))


def _controls(time: Array, x: Array) -> Array:
    """Control points of any quantity that is given at the keys."""
    if len(time) < 3:
        return x
    begin, middle, end = time[:-1:2], time[1::2], time[2::2]
    f = ((middle - begin) / (end - begin)).reshape(-1, *(1,) * (x.ndim - 1))
    inner = (x[1::2] - (1 - f) ** 2 * x[:-1:2] - f**2 * x[2::2]) / (2 * f * (1 - f))
    return x.at[1::2].set(inner)


def control_weights(
    key_time: Float[Array, " keys"], time: Float[Array, ""]
) -> Float[Array, " keys"]:
    """Share of every control point at a time: Bernstein polynomials of the time within its arc.

    Smooth within an arc, so gradients reach shutter and trigger times.
    """
    keys = key_time.shape[0]
    if keys == 1:
        return jnp.ones_like(key_time)
    knot = _knots(key_time)
    # 1 in arcs that are over, 0 in those to come.
    s = jnp.clip((time - knot[:-1]) / (knot[1:] - knot[:-1]), 0, 1)
    one = jnp.ones_like(s[:1])
    ends = jnp.concatenate([one, s]) * jnp.concatenate([1 - s, one])
    if keys == 2:
        return ends
    return jnp.zeros_like(key_time).at[::2].set(ends * ends).at[1::2].set(2 * s * (1 - s))


def arc_weights(
    key_time: Float[Array, " keys"], time: Float[Array, "*rays"]
) -> tuple[Float[Array, "*rays 3"], Int[Array, "*rays"]]:
    """The control points that share a time, three in a row, and the first of them: what of
    `control_weights` is not zero, for two keys or more (the third share of two keys is zero)."""
    knot = _knots(key_time)
    inner = knot[1:-1].reshape(*(1,) * time.ndim, -1)
    after = jnp.sum(time[..., None] >= inner, axis=-1, dtype=jnp.int32)
    begin, end = knot[after], knot[after + 1]
    s = jnp.clip((time - begin) / (end - begin), 0, 1)
    if key_time.shape[0] == 2:
        return jnp.stack([1 - s, s, jnp.zeros_like(s)], axis=-1), after
    return jnp.stack([(1 - s) ** 2, 2 * s * (1 - s), s * s], axis=-1), 2 * after


def tint_controls(motion: Motion) -> Float[Array, "keys gaussians 3"]:
    """Tints of the control points; a scene without tint has none."""
    tint = motion.gaussians.tint
    return _controls(motion.time, jnp.ones_like(motion.gaussians.mean) if tint is None else tint)


def active_controls(
    key_time: Float[Array, " keys"], earliest: Float[Array, ""], latest: Float[Array, ""]
) -> Bool[Array, " keys"]:
    """Which control points have a share in some time of the window [earliest, latest]."""
    knot = _knots(key_time)
    infinite = jnp.full_like(knot[:1], jnp.inf)
    before = jnp.concatenate([-infinite, knot[:-1]])
    after = jnp.concatenate([knot[1:], infinite])
    ends = (before <= latest) & (after >= earliest)
    if key_time.shape[0] < 3:
        return ends
    inner = (knot[:-1] <= latest) & (knot[1:] >= earliest)
    return jnp.zeros(key_time.shape, bool).at[::2].set(ends).at[1::2].set(inner)


def _knots(key_time: Array) -> Array:
    """Where arcs begin and end."""
    return key_time if key_time.shape[0] < 3 else key_time[::2]


def usable(gaussians: Gaussians) -> Bool[Array, " gaussians"]:
    """Which Gaussians can be traced: all values finite at all keys, and scales whose inverse is."""
    g = gaussians
    per_key = jnp.concatenate([g.mean, g.quat, g.scale, 1 / g.scale], axis=-1)
    fine = jnp.all(jnp.isfinite(per_key), axis=(0, -1)) & jnp.all(g.scale > 0, axis=(0, -1))
    if g.tint is not None:
        fine = fine & jnp.all(jnp.isfinite(g.tint), axis=(0, -1))
    return fine & jnp.isfinite(g.opacity) & jnp.all(jnp.isfinite(g.harmonics), axis=(1, 2))


class Columns(NamedTuple):
    """What stands where in a row of the `table`: keys x (9 + 3), opacity, harmonics, and, if the
    Gaussians are `tinted`, keys x 3."""

    keys: int
    coefficients: int
    tinted: bool

    @property
    def opacity(self) -> int:
        """The column of the opacity, behind those of the states."""
        return 12 * self.keys

    @property
    def harmonics(self) -> slice:
        """The columns of the colour."""
        return slice(self.opacity + 1, self.opacity + 1 + 3 * self.coefficients)

    @property
    def tint(self) -> slice:
        """The columns of the tint, key by key."""
        return slice(self.harmonics.stop, self.harmonics.stop + 3 * self.keys * self.tinted)


def columns(motion: Motion) -> Columns:
    """How the rows of the `table` of a motion are laid out."""
    g = motion.gaussians
    return Columns(motion.keys, g.harmonics.shape[1], g.tint is not None)


def table(motion: Motion) -> Float[Array, "rows columns"]:
    """All that shading needs of a Gaussian in one row (`Columns`): control points, opacity, colour.

    A single key stores A = S^-1 R^T (nothing to invert later); several store F = R S of the control
    points, whose blend is inverted per ray. A last row, of an ordinary Gaussian, is for slots
    without a hit; Gaussians that are not `usable` become such too, so that neither their values nor
    their gradients spread.
    """
    fine = jnp.pad(usable(motion.gaussians), (0, 1))
    g = ordinary(_one_more(motion.gaussians), fine)
    if motion.keys == 1:
        mean, matrix = g.mean, whitening(g.quat, g.scale)
    else:
        mean, matrix = controls(Motion(motion.time, g))
    state = jnp.concatenate([matrix.reshape(*matrix.shape[:2], 9), mean], axis=-1)
    parts = [_by_row(state), g.opacity[:, None], g.harmonics.reshape(g.count, -1)]
    if g.tint is not None:
        parts.append(_by_row(tint_controls(Motion(motion.time, g))))
    return jnp.concatenate(parts, axis=1)


def _by_row(x: Float[Array, "keys gaussians n"]) -> Float[Array, "gaussians columns"]:
    return jnp.moveaxis(x, 0, 1).reshape(x.shape[1], -1)


def ordinary(g: Gaussians, fine: Bool[Array, " gaussians"]) -> Gaussians:
    """Gaussians with key states; all values of those that are not fine become 1."""

    def replace(x: Array, axis: int) -> Array:
        shape = [-1 if i == axis else 1 for i in range(x.ndim)]
        return jnp.where(fine.reshape(shape), x, 1)

    return _each(replace, g)


def _one_more(g: Gaussians) -> Gaussians:
    """Room for one more Gaussian."""

    def pad(x: Array, axis: int) -> Array:
        return jnp.pad(x, [(0, 1) if i == axis else (0, 0) for i in range(x.ndim)])

    return _each(pad, g)


def _each(change: Callable[[Array, int], Array], g: Gaussians) -> Gaussians:
    """A change of every array, which is told the axis of the Gaussians."""
    return Gaussians(
        mean=change(g.mean, 1),
        quat=change(g.quat, 1),
        scale=change(g.scale, 1),
        opacity=change(g.opacity, 0),
        harmonics=change(g.harmonics, 0),
        tint=None if g.tint is None else change(g.tint, 1),
    )


def state_at(
    row: list[Float[Array, "*hits"]], weights: Float[Array, " keys *rays"]
) -> tuple[list[Float[Array, "*both"]], list[Float[Array, "*both"]]]:
    """Gaussians (a row of `table`, column by column) blended for their rays with
    `control_weights`: the nine entries of A, row by row, and the mean."""
    keys = weights.shape[0]
    if keys == 1:
        return [row[i] for i in range(9)], [row[i] for i in range(9, 12)]

    def blend(i: int) -> Array:
        total = weights[0] * row[i]
        for key in range(1, keys):
            total = total + weights[key] * row[12 * key + i]
        return total

    return _inverse([blend(i) for i in range(9)]), [blend(i) for i in range(9, 12)]


def tint_at(
    row: list[Float[Array, "*hits"]], weights: Float[Array, " keys *rays"]
) -> Float[Array, " 3 *both"]:
    """Tints (the `tint` columns of a row) blended for their rays; overshoot is cut off at 0."""

    def blend(channel: int) -> Array:
        total = weights[0] * row[channel]
        for key in range(1, weights.shape[0]):
            total = total + weights[key] * row[3 * key + channel]
        return total

    return jnp.maximum(jnp.stack([blend(channel) for channel in range(3)]), 0)


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
