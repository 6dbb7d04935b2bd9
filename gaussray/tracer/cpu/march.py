"""The march of ray bundles on a CPU as a JAX function: `march` of march.py, in machine code."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import CustomVJPPrimal, SymbolicZero
from jaxtyping import Array, Float, Int

from gaussray.runtime.machine_code import (
    allocating_code,
    flat_floats,
    floats,
    operand,
    register,
    result,
)
from gaussray.runtime.threads import (
    entry_address,
    in_threads,
    thread_count,
)
from gaussray.tracer.cpu.bundle import list_range, march_inputs
from gaussray.tracer.cpu.kernel import backward_bundles, forward_bundles
from gaussray.tracer.options import TraceOptions
from gaussray.tracer.response import reach_radius
from gaussray.tracer.table import Columns, Lanes


_FORWARD, _BACKWARD = "gaussray_march_forward", "gaussray_march_backward"
_ZERO = np.float32(0)


@allocating_code
def _extra_threads(frame):
    """Threads to start beside the caller's: each has a few bundles at least."""
    most = np.int64(flat_floats(operand(frame, 10))[2])
    return max(min(most, march_inputs(frame).start.shape[0] // 4), 1) - 1


def _forward(argument):
    in_threads(argument, entry_address(), forward_bundles, _extra_threads)
    return 0


def _backward(argument):
    if in_threads(argument, entry_address(), backward_bundles, _extra_threads):
        _sum_gradients(argument)
    return 0


@allocating_code
def _sum_gradients(frame):
    """The gradient of the table: those of all entries, in the order of the lists."""
    march, part, table = march_inputs(frame), floats(result(frame, 5)), floats(result(frame, 0))
    table[:] = _ZERO
    for bundle in range(len(march.start)):
        first, last = list_range(march, bundle)
        for place in range(first, last):
            if march.index[place] >= 0:
                row, gradient = table[march.index[place]], part[place]
                for c in range(len(gradient)):
                    row[c] += gradient[c]


def register_forward() -> None:
    """Make the forward march known to XLA (`register`)."""
    register(_FORWARD, _forward)


def register_backward() -> None:
    """Make the backward march known to XLA (`register`)."""
    register(_BACKWARD, _backward)


def _operands(table, lanes, lists, options, columns, slots, rays=False):
    """The first operands of both calls; `rays` tells whether gradients of the rays are wanted."""
    squared = reach_radius(jax.lax.stop_gradient(table[:, columns.opacity]), options.alpha_min) ** 2
    time = jnp.zeros_like(lanes.origin[:1]) if lanes.time is None else lanes.time
    numbers = (
        columns.keys,
        columns.coefficients,
        columns.window.start if columns.transient else -1,
        columns.opacity,
        columns.harmonics.start,
        columns.tint.start if columns.tinted else -1,
        slots,
        int(rays),
    )
    limits = options.alpha_max, options.transmittance_min, thread_count()
    return (
        table,
        squared,
        lanes.origin,
        lanes.direction,
        lanes.weights,
        time,
        *lists,
        np.asarray(numbers, np.int32),
        np.asarray(limits, np.float32),
    )


def _march_on_cpu(
    table: Float[Array, "rows columns"],
    lanes: Lanes,
    lists: tuple[Int[Array, " pairs"], Int[Array, " bundles"], Int[Array, " bundles"]],
    options: TraceOptions,
    columns: Columns,
    slots: int,
) -> tuple[Array, Array, Array]:
    """Channels (red, green, blue, depth), transmittance and number of hits of every ray."""
    register_forward()
    size, kind = lanes.origin.shape[1:], table.dtype
    call = jax.ffi.ffi_call(
        _FORWARD,
        (
            jax.ShapeDtypeStruct((4, *size), kind),
            jax.ShapeDtypeStruct(size, kind),
            jax.ShapeDtypeStruct(size, np.int32),
        ),
        vmap_method="sequential",
    )
    channels, end, hits = call(*_operands(table, lanes, lists, options, columns, slots))
    return channels, end, hits


def _march_forward(table, lanes, lists, options, columns, slots):
    # Rays of training pictures have no gradients, unless cameras are refined.
    differentiated = any(x.perturbed for x in jax.tree.leaves(lanes, is_leaf=_is_primal))
    table, lanes, lists = jax.tree.map(lambda x: x.value, (table, lanes, lists), is_leaf=_is_primal)
    out = _march_on_cpu(table, lanes, lists, options, columns, slots)
    # The structure tells it, as values would be traced.
    return out, (table, lanes, lists, out[0], out[1], () if differentiated else None)


def _is_primal(x):
    return isinstance(x, CustomVJPPrimal)


def _instantiated(g: Any) -> Array:
    """A cotangent as an array, also if it is zero."""
    return jnp.zeros(g.shape, np.float32) if isinstance(g, SymbolicZero) else g


def _march_backward(options, columns, slots, saved, cotangent):
    register_backward()
    table, lanes, lists, total, end, differentiated = saved
    rays = differentiated is not None
    g_total, g_end = map(_instantiated, cotangent[:2])
    operands = _operands(table, lanes, lists, options, columns, slots, rays)
    like = table, *operands[2:6]
    results = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in like]
    parts = jax.ShapeDtypeStruct((lists[0].shape[0], table.shape[1]), table.dtype)
    call = jax.ffi.ffi_call(_BACKWARD, (*results, parts), vmap_method="sequential")
    d_table, d_origin, d_direction, d_weights, d_time, _ = call(
        *operands, total, end, g_total, g_end
    )
    if not rays:
        return d_table, None, None
    d_lanes = Lanes(d_origin, d_direction, d_weights, None if lanes.time is None else d_time)
    return d_table, d_lanes, None


march_on_cpu = jax.custom_vjp(_march_on_cpu, nondiff_argnums=(3, 4, 5))
march_on_cpu.defvjp(_march_forward, _march_backward, symbolic_zeros=True)
