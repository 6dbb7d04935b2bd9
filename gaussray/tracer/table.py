"""The table of Gaussians, one row each, and the state of a Gaussian on a ray."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from gaussray.scene.gaussians import whitening_matrix
from gaussray.scene.transient import squared_age
from gaussray.tracer.alive_transients import TimeWindow, all_states
from gaussray.tracer.motion import (
    Motion,
    control_points,
    is_valid,
    pad_gaussians,
    replace_invalid,
    tint_controls,
)
from gaussray.tracer.response import response


class Columns(NamedTuple):
    """Columns of the `gaussian_table`: keys x (9 + 3), six of the `TimeWindow`, opacity, harmonics,
    and keys x 3 of the tint.

    Args:
        keys: number of key states.
        coefficients: number of harmonics per channel.
        tinted: whether there are columns of the tint.
        transient: whether there are columns of the time window.
    """

    keys: int
    coefficients: int
    tinted: bool
    transient: bool = False

    @property
    def window(self) -> slice:
        """The columns of velocity (3), instant, rate and plateau."""
        return slice(12 * self.keys, 12 * self.keys + 6 * self.transient)

    @property
    def opacity(self) -> int:
        """The column of the opacity, behind those of states and window."""
        return self.window.stop

    @property
    def harmonics(self) -> slice:
        """The columns of the colour."""
        return slice(self.opacity + 1, self.opacity + 1 + 3 * self.coefficients)

    @property
    def tint(self) -> slice:
        """The columns of the tint, key by key."""
        return slice(self.harmonics.stop, self.harmonics.stop + 3 * self.keys * self.tinted)


class Lanes(NamedTuple):
    """Rays with their components first.

    Args:
        origin: origins, in scene units.
        direction: unit directions.
        weights: weights of the control points of the motion.
        time: times, in the capture's unit; None if there are no transient Gaussians.
    """

    origin: Float[Array, " 3 *rays"]
    direction: Float[Array, " 3 *rays"]
    weights: Float[Array, " keys *rays"]
    time: Float[Array, " 1 *rays"] | None = None


def table_columns(motion: Motion) -> Columns:
    """The columns of the `gaussian_table` of a motion."""
    g, window = jax.eval_shape(all_states, motion)
    return Columns(motion.keys, g.harmonics.shape[1], g.tint is not None, window is not None)


def gaussian_table(motion: Motion) -> Float[Array, "rows columns"]:
    """The table of Gaussians: a row (`Columns`) of control points, opacity and colour for each.

    A single key stores A = S^-1 R^T (nothing to invert later); several store F = R S of the control
    points, whose blend is inverted per ray. A last row, of an ordinary Gaussian, is for slots
    without a hit; invalid Gaussians (`motion.is_valid`) are replaced by it, so that neither their
    values nor their gradients spread.
    """
    gaussians, window = all_states(motion)
    g = replace_invalid(pad_gaussians(gaussians), jnp.pad(is_valid(gaussians), (0, 1)))
    if motion.keys == 1:
        mean, matrix = g.mean, whitening_matrix(g.quat, g.scale)
    else:
        mean, matrix = control_points(Motion(motion.time, g))
    state = jnp.concatenate([matrix.reshape(*matrix.shape[:2], 9), mean], axis=-1)
    parts = [_by_row(state), g.opacity[:, None], g.harmonics.reshape(g.count, -1)]
    if window is not None:
        parts.insert(1, jnp.pad(_as_columns(window), ((0, 1), (0, 0))))
    if g.tint is not None:
        parts.append(_by_row(tint_controls(Motion(motion.time, g))))
    return jnp.concatenate(parts, axis=1)


def _as_columns(window: TimeWindow) -> Float[Array, "gaussians 6"]:
    last = jnp.stack([window.instant, window.rate, window.plateau], axis=1)
    return jnp.concatenate([window.velocity, last], axis=1)


def _by_row(x: Float[Array, "keys gaussians n"]) -> Float[Array, "gaussians columns"]:
    return jnp.moveaxis(x, 0, 1).reshape(x.shape[1], -1)


def ray_response(
    row: list[Float[Array, "*hits"]], lanes: Lanes, columns: Columns
) -> tuple[Float[Array, "*both"], Float[Array, "*both"]]:
    """Distance t of the peak along every ray, and the squared distance there (`response`).

    The squared distance of a transient Gaussian is that in space and time, q + s^2
    (`squared_age`).

    Args:
        row: a row of `gaussian_table`, column by column.
        lanes: the rays, which meet it at their own times.
        columns: columns of the row.
    """
    whiten, mean = state_at(row, lanes.weights)
    if lanes.time is None:
        return response(whiten, mean, lanes.origin, lanes.direction)
    *velocity, instant, rate, plateau = row[columns.window]
    age = lanes.time[0] - instant
    mean = [x + age * v for x, v in zip(mean, velocity, strict=True)]
    t, q = response(whiten, mean, lanes.origin, lanes.direction)
    return t, q + squared_age(age, rate, plateau)


def state_at(
    row: list[Float[Array, "*hits"]], weights: Float[Array, " keys *rays"]
) -> tuple[list[Float[Array, "*both"]], list[Float[Array, "*both"]]]:
    """State of a Gaussian on rays: the nine entries of A, row by row, and the mean.

    Args:
        row: a row of `gaussian_table`, column by column.
        weights: weights of the control points (`control_weights`).
    """
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
    """Tint of a Gaussian on rays; negative values are set to 0.

    Args:
        row: the `tint` columns of a row.
        weights: weights of the control points (`control_weights`).
    """

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
