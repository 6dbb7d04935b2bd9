"""Linear blend skinning in machine code for a CPU (Numba): `control_points.skinned` and the
gradient of what is blended.

The Gaussians are dealt out in pieces to the threads of a call. Each piece of the backward pass sums
into a table of its own, so that results do not depend on the threads.
"""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.runtime.machine_code import (
    allocating_code,
    flat_floats,
    floats,
    integers,
    machine_code,
    operand,
    power_of_two,
    register,
    result,
    summing_code,
)
from gaussray.runtime.threads import (
    call_frame,
    entry_address,
    in_threads,
    next_piece,
    thread_count,
)


_FORWARD, _BACKWARD = "gaussray_skinning_forward", "gaussray_skinning_backward"
# Gaussians of a piece of the forward pass; pieces of the backward pass.
_PIECE, _PIECES = 256, 8
# Numbers of a vector, so that the largest of all is found side by side.
_LANES = 16
_ZERO, _ONE = np.float32(0), np.float32(1)
# Where there is no control point, so that all numbers of a vector have one.
_NOWHERE = np.float32(1e15)
# exp(x) = 2^(x / log 2): powers below 2^-126 are not told apart; what is added to a number and
# taken from it rounds it; and sum_k (x log 2)^k / k! for |x| <= 1/2.
_EXPONENT, _LOWEST, _SHIFT = np.float32(1 / math.log(2)), np.float32(-126), np.float32(3 << 22)
_P0, _P1, _P2, _P3, _P4, _P5, _P6, _P7 = (
    np.float32(math.log(2) ** k / math.factorial(k)) for k in range(8)
)


class _Points(NamedTuple):
    """Coordinates of the control points, 1 / (2 radius^2), and room for weights, each padded; and
    room for the largest exponent of each lane."""

    x: Any
    y: Any
    z: Any
    factor: Any
    weight: Any
    top: Any


@allocating_code
def _points(frame):
    pivot, factor = floats(operand(frame, 0)), flat_floats(operand(frame, 1))
    count = len(factor)
    padded = (count + _LANES - 1) // _LANES * _LANES
    rows = np.full((5, padded), _NOWHERE, np.float32)
    for k in range(count):
        rows[0, k], rows[1, k], rows[2, k] = pivot[k, 0], pivot[k, 1], pivot[k, 2]
        rows[3, k] = factor[k]
    rows[3, count:] = _ONE
    return _Points(rows[0], rows[1], rows[2], rows[3], rows[4], np.empty(_LANES, np.float32))


@machine_code
def _exponents(points, x, y, z):
    """Store the exponents of all weights, and return the largest."""
    px, py, pz, factor, weight, top = points
    for k in range(len(weight)):
        dx, dy, dz = px[k] - x, py[k] - y, pz[k] - z
        weight[k] = -factor[k] * (dx * dx + dy * dy + dz * dz)
    for lane in range(_LANES):
        top[lane] = weight[lane]
    for begin in range(_LANES, len(weight), _LANES):
        row = weight[begin : begin + _LANES]
        for lane in range(_LANES):
            top[lane] = top[lane] if top[lane] > row[lane] else row[lane]
    largest = top[0]
    for lane in range(1, _LANES):
        largest = max(largest, top[lane])
    return largest


@machine_code
def _powers(weight, largest):
    """Make weights of their exponents, as shares of the largest one."""
    for k in range(len(weight)):
        x = max((weight[k] - largest) * _EXPONENT, _LOWEST)
        shifted = x + _SHIFT
        x -= shifted - _SHIFT
        power = _P4 + x * (_P5 + x * (_P6 + x * _P7))
        power = _P0 + x * (_P1 + x * (_P2 + x * (_P3 + x * power)))
        weight[k] = power * power_of_two(shifted)


@summing_code
def _sum(weight):
    total = _ZERO
    for k in range(len(weight)):
        total += weight[k]
    return total


@machine_code
def _weigh(points, position, i):
    """The weights of the control points for a Gaussian, and their sum."""
    largest = _exponents(points, position[i, 0], position[i, 1], position[i, 2])
    _powers(points.weight, largest)
    return _sum(points.weight)


@summing_code
def _dots(weight, columns, c):
    """The sums of the products of a row and four columns."""
    p, q, r, s = columns[c], columns[c + 1], columns[c + 2], columns[c + 3]
    a, b, d, e = _ZERO, _ZERO, _ZERO, _ZERO
    for k in range(len(weight)):
        a += weight[k] * p[k]
        b += weight[k] * q[k]
        d += weight[k] * r[k]
        e += weight[k] * s[k]
    return a, b, d, e


@summing_code
def _add(sums, factor, weight):
    """Add a row times a factor to another one."""
    for k in range(len(sums)):
        sums[k] += factor * weight[k]


@allocating_code
def _forward_pieces(shared):
    """What all Gaussians blend that no other thread takes."""
    frame = call_frame(shared)
    points, position = _points(frame), floats(operand(frame, 2))
    table, out = floats(operand(frame, 3)), floats(result(frame, 0))
    wanted = table.shape[1]
    columns = np.zeros(((wanted + 3) // 4 * 4, len(points.weight)), np.float32)
    columns[:wanted, : len(table)] = table.T
    row = np.empty(len(columns), np.float32)
    while True:
        begin = next_piece(shared) * _PIECE
        if begin >= len(position):
            return
        for i in range(begin, min(begin + _PIECE, len(position))):
            share = _ONE / _weigh(points, position, i)
            for c in range(0, len(columns), 4):
                row[c], row[c + 1], row[c + 2], row[c + 3] = _dots(points.weight, columns, c)
            for c in range(wanted):
                out[i, c] = share * row[c]


@allocating_code
def _backward_pieces(shared):
    """Gradients of the table of all pieces that no other thread takes."""
    frame = call_frame(shared)
    points, position = _points(frame), floats(operand(frame, 2))
    g, d_table = floats(operand(frame, 3)), floats(result(frame, 0))
    count, pieces = len(flat_floats(operand(frame, 1))), np.int64(integers(operand(frame, 4))[1])
    sums = np.empty((g.shape[1], len(points.weight)), np.float32)
    while True:
        piece = next_piece(shared)
        if piece >= pieces:
            return
        sums[:] = _ZERO
        for i in range(piece * len(position) // pieces, (piece + 1) * len(position) // pieces):
            share = _ONE / _weigh(points, position, i)
            for c in range(len(sums)):
                _add(sums[c], share * g[i, c], points.weight)
        d_table[piece] = sums[:, :count].copy().reshape(-1)


@allocating_code
def _extra_threads(frame):
    """Threads to start beside the caller's: each has some hundred Gaussians at least."""
    most, count = np.int64(integers(operand(frame, 4))[0]), len(floats(operand(frame, 2)))
    return max(min(most, count // 500), 1) - 1


def _forward(argument):
    in_threads(argument, entry_address(), _forward_pieces, _extra_threads)
    return 0


def _backward(argument):
    in_threads(argument, entry_address(), _backward_pieces, _extra_threads)
    return 0


def register_blend() -> None:
    """Make the forward pass known to XLA (`register`)."""
    register(_FORWARD, _forward)


def blended_on_cpu(
    pivot: Float[Array, "points 3"],
    radius: Float[Array, " points"],
    position: Float[Array, "gaussians 3"],
    table: Float[Array, "points columns"],
) -> Float[Array, "gaussians columns"]:
    """`control_points.skinned`.

    Args:
        pivot: places of the control points.
        radius: widths of their weights.
        position: centres of the Gaussians.
        table: what is blended.
    """
    register_blend()
    shape = position.shape[0], table.shape[1]
    out = jax.ShapeDtypeStruct(shape, position.dtype)
    call = jax.ffi.ffi_call(_FORWARD, out, vmap_method="sequential")
    return call(pivot, 0.5 / radius**2, position, table, _sizes())


def table_gradient_on_cpu(
    pivot: Float[Array, "points 3"],
    radius: Float[Array, " points"],
    position: Float[Array, "gaussians 3"],
    g: Float[Array, "gaussians columns"],
) -> Float[Array, "points columns"]:
    """The gradient of the table.

    Args:
        pivot: as for `blended_on_cpu`.
        radius: as for `blended_on_cpu`.
        position: as for `blended_on_cpu`.
        g: the gradient of what was blended.
    """
    register(_BACKWARD, _backward)
    shape = _PIECES, g.shape[1] * pivot.shape[0]
    out = jax.ShapeDtypeStruct(shape, position.dtype)
    call = jax.ffi.ffi_call(_BACKWARD, out, vmap_method="sequential")
    parts = call(pivot, 0.5 / radius**2, position, g, _sizes())
    return jnp.sum(parts, axis=0).reshape(g.shape[1], pivot.shape[0]).T


def _sizes() -> np.ndarray:
    return np.asarray((thread_count(), _PIECES), np.int32)
