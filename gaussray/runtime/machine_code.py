"""Functions compiled by Numba inside a JAX program on a CPU: XLA calls them through its FFI.

XLA hands over one pointer, to a call frame (struct XLA_FFI_CallFrame of xla/ffi/api/c_api.h, whose
layout is stable). `operand` and `result` find the arrays behind it.
"""

import ctypes
import functools
import hashlib
import inspect
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numba.extending
import numpy as np
from llvmlite import ir
from numba import cfunc, njit, types
from numba.np.numpy_support import carray


# Only compiled code calls these functions: they need no wrappers.
_ALLOCATING: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}}
_ALLOCATING |= {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
# Without Numba's run time, which counts the references to every array that a function is given:
# that takes longer than many a function.
_OPTIONS = {**_ALLOCATING, "_nrt": False}


# A decorator that checks types (of tests, say) may stand between a function and what compiles it.
def machine_code(function: Callable) -> Any:
    """Compile a function when compiled code first calls it. It makes no arrays."""
    return njit(**_OPTIONS)(inspect.unwrap(function))


def allocating_code(function: Callable) -> Any:
    """Like `machine_code`, for a function that makes arrays or hands on new ones."""
    return njit(**_ALLOCATING)(inspect.unwrap(function))


def pasted_code(function: Callable) -> Any:
    """Like `allocating_code`, but part of what calls it: for a function of functions, as code that
    is given others would not be kept on disk."""
    return njit(**_ALLOCATING, inline="always")(inspect.unwrap(function))


def summing_code(function: Callable) -> Any:
    """Like `machine_code`, but sums may be taken in any order, so that vectors add them up. This
    holds for what is written in the function itself, not for what it calls."""
    options = {**_OPTIONS, "fastmath": {"contract", "reassoc", "nsz"}}
    return njit(**options)(inspect.unwrap(function))


def inlined_code(function: Callable) -> Any:
    """Like `machine_code`, but inlined: passing arrays takes as long as a short function."""
    return njit(**_OPTIONS, forceinline=True)(inspect.unwrap(function))


def entry(function: Callable) -> Any:
    """Compile a function of one 64-bit number now, or load it from disk; C can call it."""
    function = inspect.unwrap(function)
    # Numba takes what is on disk for old if the function's own file is newer, but not if another is
    # that it calls: these are part of its name there.
    folder = Path(inspect.getfile(function)).parent
    function.__qualname__ = f"{function.__name__}_{_version(folder)}"
    signature = types.int64(types.int64)
    try:
        return cfunc(signature, cache=True)(function)
    except RuntimeError:  # no folder to write to
        return cfunc(signature)(function)


@functools.cache
def _version(folder: Path) -> str:
    """A number for what the sources of a folder and of this module's own folder hold."""
    parts = [*sorted(folder.glob("*.py")), *sorted(Path(__file__).parent.glob("*.py"))]
    return hashlib.sha256(b"".join(part.read_bytes() for part in parts)).hexdigest()[:12]


def intrinsic(function: Callable) -> Any:
    """A function whose code in LLVM's language another function writes."""
    return numba.extending.intrinsic(inspect.unwrap(function))


# Byte offsets: in the frame, of the extension (in calls that ask for the version), XLA's interface,
# the stage, and the pointers to operands and results; in a buffer, of its data, rank, dimensions.
_EXTENSION, _INTERFACE, _STAGE, _OPERANDS, _RESULTS = 8, 16, 32, 72, 112
_DATA, _RANK, _DIMENSIONS = 24, 32, 40
# In an extension: its type (1: metadata) and the metadata; there, the version that is asked for; in
# the interface, XLA's own version, whose larger number tells layouts apart: this one's is 0.
_TYPE, _METADATA, _MAJOR, _MINOR, _OWN_MAJOR, _OWN_MINOR = 8, 24, 24, 28, 32, 36
_IS_METADATA, _EXECUTE, _LAYOUT = 1, 3, 0


def _reader(bits: int, kind: types.Type) -> Any:
    """A function of an address: the number that stands there."""

    @intrinsic
    def read(_, address):
        def code(context, builder, signature, arguments):
            return builder.load(builder.inttoptr(arguments[0], ir.IntType(bits).as_pointer()))

        return kind(types.int64), code

    return read


@intrinsic
def _write(_, address, value):
    def code(context, builder, signature, arguments):
        place = builder.inttoptr(arguments[0], ir.IntType(32).as_pointer())
        builder.store(arguments[1], place)
        return context.get_dummy_value()

    return types.void(types.int64, types.int32), code


@intrinsic
def power_of_two(_, shifted):
    """2^n in single precision, for a whole number n from -126 to 127.

    Args:
        shifted: n + 1.5 x 2^23 in single precision, whose last bits are those of n.
    """

    def code(context, builder, signature, arguments):
        bits = ir.IntType(32)
        n = builder.shl(builder.bitcast(arguments[0], bits), ir.Constant(bits, 23))
        return builder.bitcast(builder.add(n, ir.Constant(bits, 127 << 23)), ir.FloatType())

    return types.float32(types.float32), code


def _pointer(kind: types.Type, form: ir.Type) -> Any:
    """A function of an address: a pointer to numbers of this kind."""

    @intrinsic
    def pointer(_, address):
        def code(context, builder, signature, arguments):
            return builder.inttoptr(arguments[0], form.as_pointer())

        return types.CPointer(kind)(types.int64), code

    return pointer


word_at, _number = _reader(64, types.int64), _reader(32, types.int32)
_float_pointer = _pointer(types.float32, ir.FloatType())
_int_pointer = _pointer(types.int32, ir.IntType(32))


@machine_code
def operand(frame, i):
    """The address of an operand's buffer.

    Args:
        frame: address of the call frame.
        i: index of the operand, from 0.
    """
    return word_at(word_at(frame + _OPERANDS) + 8 * i)


@machine_code
def result(frame, i):
    """The address of a result's buffer.

    Args:
        frame: address of the call frame.
        i: index of the result, from 0.
    """
    return word_at(word_at(frame + _RESULTS) + 8 * i)


@machine_code
def _size(buffer):
    """Number of elements along the first axis, and of all others together."""
    rank, place = word_at(buffer + _RANK), word_at(buffer + _DIMENSIONS)
    rest = 1
    for k in range(1, rank):
        rest *= word_at(place + 8 * k)
    return (word_at(place) if rank > 0 else 1), rest


@allocating_code
def floats(buffer):
    """A buffer as an array of float32, (first axis, all others)."""
    return carray(_float_pointer(word_at(buffer + _DATA)), _size(buffer))


@allocating_code
def flat_floats(buffer):
    """A buffer as an array of float32 with one axis."""
    first, rest = _size(buffer)
    return carray(_float_pointer(word_at(buffer + _DATA)), (first * rest,))


@allocating_code
def integers(buffer):
    """A buffer as an array of int32 with one axis."""
    first, rest = _size(buffer)
    return carray(_int_pointer(word_at(buffer + _DATA)), (first * rest,))


@machine_code
def is_execution(frame):
    """Whether a call is to compute. A call that asks for the interface's version is answered."""
    extension = word_at(frame + _EXTENSION)
    if extension != 0 and _number(extension + _TYPE) == _IS_METADATA:
        metadata, interface = word_at(extension + _METADATA), word_at(frame + _INTERFACE)
        minor = np.int32(1)
        if interface != 0 and _number(interface + _OWN_MAJOR) == _LAYOUT:
            minor = _number(interface + _OWN_MINOR)
        _write(metadata + _MAJOR, np.int32(_LAYOUT))
        _write(metadata + _MINOR, minor)
        return False
    return _number(frame + _STAGE) == _EXECUTE


# Threads may ask for the same function at the same time.
_registering = threading.Lock()


def register(name: str, function: Callable) -> None:
    """Compile a function, or load it from disk, and make it known to XLA on CPUs; only once.

    Args:
        name: name under which `jax.ffi.ffi_call` calls it.
        function: a function of one 64-bit number, to be compiled by `entry`.
    """
    with _registering:
        _register(name, function)


@functools.cache
def _register(name: str, function: Callable) -> None:
    handler, capsule = entry(function), ctypes.pythonapi.PyCapsule_New
    capsule.restype = ctypes.py_object
    capsule.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
    jax.ffi.register_ffi_target(
        name, capsule(handler.address, None, None), platform="cpu", api_version=1
    )
