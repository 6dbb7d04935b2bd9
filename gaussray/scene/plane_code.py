"""Products of plane samples in machine code for a CPU (Numba): `planes.plane_product` and its
gradients.

The Gaussians are dealt out in pieces to the threads of a call. Each piece of the backward pass sums
into planes of its own, so that results do not depend on the threads.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.runtime.machine_code import (
    allocating_code,
    flat_floats,
    inlined_code,
    integers,
    machine_code,
    operand,
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


_FORWARD, _BACKWARD = "gaussray_planes_forward", "gaussray_planes_backward"
# Gaussians of a piece of the forward pass; pieces of the backward pass, fewer where their planes
# would take more numbers than that.
_PIECE, _PIECES, _NUMBERS = 512, 8, 1 << 24
# First and second axis of the planes xy, xz and yz.
_FIRST, _SECOND = (0, 0, 1), (1, 2, 2)
_ZERO, _ONE = np.float32(0), np.float32(1)


class _Inputs(NamedTuple):
    """Operands of a call: the spatial planes, the lines, positions, and sizes."""

    space: Any
    line: Any
    unit: Any
    side: Any
    channels: Any
    count: Any


@allocating_code
def _inputs(frame):
    sizes = integers(operand(frame, 3))
    return _Inputs(
        flat_floats(operand(frame, 0)),
        flat_floats(operand(frame, 1)),
        flat_floats(operand(frame, 2)),
        np.int64(sizes[0]),
        np.int64(sizes[1]),
        np.int64(sizes[2]),
    )


@inlined_code
def _knot(x, side):
    """Lower knot and fraction of a position among the knots of a side."""
    place = x * np.float32(side - 1)
    # What is not a number becomes a knot, too.
    low = min(max(np.int64(place), 0), side - 2)
    return low, place - np.float32(low)


@inlined_code
def _corner(inputs, i, plane):
    """Where the square of knots around a Gaussian begins in a plane, and its fractions."""
    first, second = _FIRST[plane], _SECOND[plane]
    column, right = _knot(inputs.unit[3 * i + first], inputs.side)
    row, down = _knot(inputs.unit[3 * i + second], inputs.side)
    at = ((plane * inputs.side + row) * inputs.side + column) * inputs.channels
    return at, right, down


@inlined_code
def _start(inputs, i, axis):
    """Where the pair of knots around a Gaussian begins in a line, and its fraction."""
    low, right = _knot(inputs.unit[3 * i + axis], inputs.side)
    return (axis * inputs.side + low) * inputs.channels, right


@summing_code
def _sample_plane(space, at, down_step, weights, out):
    """Bilinear samples of all channels of a plane."""
    count = len(out)
    a, b = space[at : at + count], space[at + count : at + 2 * count]
    at += down_step
    c, d = space[at : at + count], space[at + count : at + 2 * count]
    w0, w1, w2, w3 = weights
    for k in range(count):
        out[k] = w0 * a[k] + w1 * b[k] + w2 * c[k] + w3 * d[k]


@summing_code
def _sample_line(line, at, right, out):
    """Linear samples of all channels of a line."""
    count = len(out)
    a, b = line[at : at + count], line[at + count : at + 2 * count]
    left = _ONE - right
    for k in range(count):
        out[k] = left * a[k] + right * b[k]


@inlined_code
def _corner_weights(right, down):
    left, up = _ONE - right, _ONE - down
    return left * up, right * up, left * down, right * down


@machine_code
def _samples(inputs, i, values):
    """The six samples of a Gaussian, in the rows of `values`."""
    step = inputs.side * inputs.channels
    for plane in range(3):
        at, right, down = _corner(inputs, i, plane)
        _sample_plane(inputs.space, at, step, _corner_weights(right, down), values[plane])
    for axis in range(3):
        at, right = _start(inputs, i, axis)
        _sample_line(inputs.line, at, right, values[3 + axis])


@summing_code
def _multiply(values, out):
    """Products of six rows."""
    a, b, c, d, e, f = values[0], values[1], values[2], values[3], values[4], values[5]
    for k in range(len(out)):
        out[k] = a[k] * b[k] * c[k] * d[k] * e[k] * f[k]


@summing_code
def _share(values, g, d_values):
    """Gradients of six rows, of that of their product."""
    a, b, c, d, e, f = values[0], values[1], values[2], values[3], values[4], values[5]
    d_a, d_b, d_c = d_values[0], d_values[1], d_values[2]
    d_d, d_e, d_f = d_values[3], d_values[4], d_values[5]
    for k in range(len(g)):
        abc, def_ = g[k] * a[k] * b[k] * c[k], g[k] * d[k] * e[k] * f[k]
        d_a[k], d_b[k], d_c[k] = b[k] * c[k] * def_, a[k] * c[k] * def_, a[k] * b[k] * def_
        d_d[k], d_e[k], d_f[k] = abc * e[k] * f[k], abc * d[k] * f[k], abc * d[k] * e[k]


@summing_code
def _add(sums, at, weight, values):
    """Add a row times a weight to what begins at a place."""
    own = sums[at : at + len(values)]
    for k in range(len(values)):
        own[k] += weight * values[k]


@summing_code
def _slopes(space, at, down_step, fractions, g):
    """Derivatives of a plane's sample to the right and down, times its gradient, over channels."""
    count, (right, down) = len(g), fractions
    a, b = space[at : at + count], space[at + count : at + 2 * count]
    at += down_step
    c, d = space[at : at + count], space[at + count : at + 2 * count]
    left, up, to_right, to_down = _ONE - right, _ONE - down, _ZERO, _ZERO
    for k in range(count):
        to_right += g[k] * (up * (b[k] - a[k]) + down * (d[k] - c[k]))
        to_down += g[k] * (left * (c[k] - a[k]) + right * (d[k] - b[k]))
    return to_right, to_down


@summing_code
def _slope(line, at, g):
    """Derivative of a line's sample, times a gradient, over all channels."""
    count = len(g)
    a, b, total = line[at : at + count], line[at + count : at + 2 * count], _ZERO
    for k in range(count):
        total += g[k] * (b[k] - a[k])
    return total


@allocating_code
def _forward_pieces(shared):
    """Features of all Gaussians that no other thread takes."""
    frame = call_frame(shared)
    inputs, out = _inputs(frame), flat_floats(result(frame, 0))
    channels = inputs.channels
    values = np.empty((6, channels), np.float32)
    while True:
        begin = next_piece(shared) * _PIECE
        if begin >= inputs.count:
            return
        for i in range(begin, min(begin + _PIECE, inputs.count)):
            _samples(inputs, i, values)
            _multiply(values, out[i * channels : (i + 1) * channels])


@machine_code
def _add_gradients(inputs, i, d_values, d_space, d_line):
    """Add the gradients of a Gaussian's samples to those of the knots around it."""
    channels, down_step = inputs.channels, inputs.side * inputs.channels
    for plane in range(3):
        at, right, down = _corner(inputs, i, plane)
        w0, w1, w2, w3 = _corner_weights(right, down)
        _add(d_space, at, w0, d_values[plane])
        _add(d_space, at + channels, w1, d_values[plane])
        _add(d_space, at + down_step, w2, d_values[plane])
        _add(d_space, at + down_step + channels, w3, d_values[plane])
    for axis in range(3):
        at, right = _start(inputs, i, axis)
        _add(d_line, at, _ONE - right, d_values[3 + axis])
        _add(d_line, at + channels, right, d_values[3 + axis])


@machine_code
def _add_position(inputs, i, d_values, d_unit):
    """The gradient of a Gaussian's position."""
    scale, step = np.float32(inputs.side - 1), inputs.side * inputs.channels
    for axis in range(3):
        d_unit[3 * i + axis] = scale * _slope(
            inputs.line, _start(inputs, i, axis)[0], d_values[3 + axis]
        )
    for plane in range(3):
        at, right, down = _corner(inputs, i, plane)
        across, along = _slopes(inputs.space, at, step, (right, down), d_values[plane])
        first, second = _FIRST[plane], _SECOND[plane]
        d_unit[3 * i + first] += scale * across
        d_unit[3 * i + second] += scale * along


@allocating_code
def _backward_pieces(shared):
    """Gradients of all pieces of the Gaussians that no other thread takes."""
    frame = call_frame(shared)
    inputs, g = _inputs(frame), flat_floats(operand(frame, 4))
    sizes = integers(operand(frame, 3))
    pieces, moves = np.int64(sizes[4]), sizes[5] != 0
    d_space, d_line = flat_floats(result(frame, 0)), flat_floats(result(frame, 1))
    d_unit = flat_floats(result(frame, 2))
    channels, spatial, linear = inputs.channels, len(inputs.space), len(inputs.line)
    both = np.empty((2, 6, channels), np.float32)
    values, d_values = both[0], both[1]
    while True:
        piece = next_piece(shared)
        if piece >= pieces:
            return
        own_space = d_space[piece * spatial : (piece + 1) * spatial]
        own_line = d_line[piece * linear : (piece + 1) * linear]
        own_space[:], own_line[:] = _ZERO, _ZERO
        for i in range(piece * inputs.count // pieces, (piece + 1) * inputs.count // pieces):
            _samples(inputs, i, values)
            _share(values, g[i * channels : (i + 1) * channels], d_values)
            _add_gradients(inputs, i, d_values, own_space, own_line)
            if moves:
                _add_position(inputs, i, d_values, d_unit)


@allocating_code
def _extra_threads(frame):
    """Threads to start beside the caller's: each has a thousand Gaussians at least."""
    sizes = integers(operand(frame, 3))
    return max(min(np.int64(sizes[3]), np.int64(sizes[2]) // 1000), 1) - 1


def _forward(argument):
    in_threads(argument, entry_address(), _forward_pieces, _extra_threads)
    return 0


def _backward(argument):
    in_threads(argument, entry_address(), _backward_pieces, _extra_threads)
    return 0


def register_plane_samples() -> None:
    """Make the forward pass known to XLA (`register`)."""
    register(_FORWARD, _forward)


def forward_on_cpu(
    space: Float[Array, "3 side side channels"],
    line: Float[Array, "3 side channels"],
    unit: Float[Array, "gaussians 3"],
) -> Float[Array, "gaussians channels"]:
    """`planes.plane_product`.

    Args:
        space: the planes xy, xz, yz.
        line: the lines of x, y, z.
        unit: positions, in the unit cube.
    """
    register_plane_samples()
    out = jax.ShapeDtypeStruct((unit.shape[0], line.shape[-1]), unit.dtype)
    call = jax.ffi.ffi_call(_FORWARD, out, vmap_method="sequential")
    return call(space, line, unit, _sizes(line, unit, 0, False))


def backward_on_cpu(
    space: Float[Array, "3 side side channels"],
    line: Float[Array, "3 side channels"],
    unit: Float[Array, "gaussians 3"],
    g: Float[Array, "gaussians channels"],
    *,
    moves: bool,
) -> tuple[Array, Array, Array | None]:
    """Gradients of `space`, `line` and, if it is wanted, `unit`.

    Args:
        space: as for `forward_on_cpu`.
        line: as for `forward_on_cpu`.
        unit: as for `forward_on_cpu`.
        g: the gradient of the products.
        moves: whether the gradient of `unit` is wanted.
    """
    register(_BACKWARD, _backward)
    pieces = max(1, min(_PIECES, _NUMBERS // space.size))
    shapes = (pieces, *space.shape), (pieces, *line.shape), unit.shape if moves else (1, 3)
    results = [jax.ShapeDtypeStruct(shape, unit.dtype) for shape in shapes]
    call = jax.ffi.ffi_call(_BACKWARD, results, vmap_method="sequential")
    d_space, d_line, d_unit = call(space, line, unit, _sizes(line, unit, pieces, moves), g)
    return jnp.sum(d_space, axis=0), jnp.sum(d_line, axis=0), d_unit if moves else None


def _sizes(line: Array, unit: Array, pieces: int, moves: bool) -> np.ndarray:
    side, channels = line.shape[1:]
    return np.asarray((side, channels, unit.shape[0], thread_count(), pieces, int(moves)), np.int32)
