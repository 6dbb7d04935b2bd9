"""Threads of a call of machine code: they take pieces of its work until none is left."""

import os

import jax
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils

from gaussray.runtime.devices import cores
from gaussray.runtime.machine_code import (
    allocating_code,
    intrinsic,
    is_execution,
    machine_code,
    pasted_code,
    word_at,
)


@intrinsic
def _taken(_, address, count):
    """The number at an address, which then grows by `count`, whichever thread asks."""

    def code(context, builder, signature, arguments):
        place = builder.inttoptr(arguments[0], ir.IntType(64).as_pointer())
        return builder.atomic_rmw("add", place, arguments[1], "seq_cst")

    return types.int64(types.int64, types.int64), code


@intrinsic
def entry_address(_):
    """The address of the `entry` that asks for it."""

    def code(context, builder, signature, arguments):
        kind = ir.FunctionType(ir.IntType(64), [ir.IntType(64)])
        # Numba's name for what C calls.
        name = f"cfunc.{builder.function.name}"
        function = cgutils.get_or_insert_function(builder.module, kind, name)
        return builder.ptrtoint(function, ir.IntType(64))

    return types.int64(), code


_POSIX = os.name == "posix"
_create = types.ExternalFunction("pthread_create", types.int32(*[types.int64] * 4))
_join = types.ExternalFunction("pthread_join", types.int32(*[types.int64] * 2))


@allocating_code
def shared_state(frame):
    """The shared state of the threads of a call: the number of pieces taken, the frame, and the
    number of places taken."""
    shared = np.zeros(3, np.int64)
    shared[1] = frame
    return shared


@machine_code
def call_frame(shared):
    """The address of the call frame, from the address of the shared state."""
    return word_at(shared + 8)


@machine_code
def next_piece(shared):
    """Take the next piece of work, and return its number."""
    return _taken(shared, 1)


@machine_code
def take_places(shared, count):
    """Take places of a result that all threads fill, and return the number of the first.

    Args:
        shared: address of the shared state.
        count: how many.
    """
    return _taken(shared + 16, count)


@machine_code
def shared_address(argument):
    """The address of the shared state, from the argument of an entry; 0 if XLA calls."""
    return argument - 1 if argument & 1 else 0


@allocating_code
def start_threads(entry, shared, threads):
    """Start threads that run an entry, and return their identifiers.

    They call it with the address of the shared state plus 1: no address is odd, which distinguishes
    their calls from XLA's. Where threads cannot be started, fewer come back.

    Args:
        entry: address of the entry (`entry_address`).
        shared: address of the shared state.
        threads: number of threads to start beside the caller's.
    """
    identifiers = np.zeros(max(threads, 1), np.int64)
    count = 0
    if _POSIX:
        for k in range(threads):
            place = identifiers.ctypes.data + 8 * k
            if _create(place, 0, entry, shared + 1) != 0:
                break
            count += 1
    return identifiers[:count]


@allocating_code
def join_threads(identifiers, shared):
    """Wait for threads to end.

    Args:
        identifiers: identifiers of the threads (`start_threads`).
        shared: array of the shared state, which is written last: Numba frees an array after its
            last use, and does not see that the threads use its address.
    """
    if _POSIX:
        for identifier in identifiers:
            _join(identifier, 0)
    shared[1] = 0


@pasted_code
def in_threads(argument, entry, pieces, extra_threads):
    """Do the work of an entry in threads, and tell whether all of it is done: XLA called, to
    compute, and not a thread.

    Args:
        argument: the argument of the entry.
        entry: the entry's own address (`entry_address`).
        pieces: takes pieces of the work until none is left; a function of the address of the
            shared state.
        extra_threads: the number of threads beside the caller's; a function of the address of the
            call frame.
    """
    shared = shared_address(argument)
    if shared:
        pieces(shared)
    elif is_execution(argument):
        common = shared_state(argument)
        address = np.int64(common.ctypes.data)
        others = start_threads(entry, address, extra_threads(argument))
        pieces(address)
        join_threads(others, common)
        return True
    return False


def thread_count() -> int:
    """Threads of a call: the processors of this process, shared by the devices that JAX makes of
    them, each of which may call at once."""
    return max(1, cores() // jax.local_device_count("cpu"))
