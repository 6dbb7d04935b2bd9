"""Plain numbers and lists in, readable text out: converters and reprs of the public classes."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, DTypeLike


# Numbers of an array that a repr shows; of a larger one it shows type and shape.
_SHOWN = 16
# What lists hold that numpy would turn into numbers, and are none.
_NO_NUMBERS = (str, bytes, type(None))
# Columns up to which a repr stays on one line.
_LINE = 88


def number(key: str) -> Callable[[Any], Array]:
    """A converter of a field that holds one number; arrays pass as they are."""
    return lambda value: to_array(key, value, "a number", ())


def vector(key: str, length: int | None = None, *, spread: bool = False) -> Callable[[Any], Array]:
    """A converter of a field that holds a list of numbers.

    Args:
        key: the name of the field in messages.
        length: how many numbers; None is any number of them.
        spread: whether one number stands for `length` equal ones; without a length, a plain number
            for a list of one.
    """
    rule = "a list of numbers" if length is None else f"{length} numbers"

    def convert(value: Any) -> Array:
        if spread and _is_single(value) and (length or not _is_array(value)):
            value = [value] * (length or 1)
        return to_array(key, value, rule, (length,))

    return convert


def rows(key: str, length: int) -> Callable[[Any], Array]:
    """A converter of a field that holds a list of points; one point stands for a list of one.

    Args:
        key: the name of the field in messages.
        length: how many numbers a point has.
    """

    def convert(value: Any) -> Array:
        if isinstance(value, list | tuple) and all(map(_is_single, value)):
            value = [value]
        return to_array(key, value, f"a list of {length} numbers each", (None, length))

    return convert


def optional(convert: Callable[[Any], Array]) -> Callable[[Any], Array | None]:
    """The converter of a field that may be None."""
    return lambda value: None if value is None else convert(value)


def whole_number(value: Any) -> Any:
    """A converter of a field that holds a whole number: numpy's become Python's, all else stays."""
    return int(value) if isinstance(value, np.integer) else value


def to_device(values: Any, dtype: DTypeLike | None = None) -> Array:
    """Numbers of the host as an array on the device.

    Outside of `jit`, `jnp.asarray` runs a program instead, one for every shape: it is compiled
    first, and then waits for all programs that run.

    Args:
        values: numbers, nested lists of them or a NumPy array. An array of JAX stays where it is.
        dtype: type of the result; None keeps that of the values.
    """
    if isinstance(values, jax.Array):
        return jnp.asarray(values, dtype)
    return jax.device_put(np.array(values, dtype))


def to_array(key: str, value: Any, rule: str, shape: tuple[int | None, ...]) -> Any:
    """Numbers as a floating-point array.

    Args:
        key: the name of the value in messages.
        value: numbers or nested lists of numbers, which must have the `shape`; or an array, which
            must end in it, and keeps its leading axes and precision (whole numbers become floats).
        rule: what the value must be, for the message.
        shape: the lengths of the axes, None where any length is allowed.

    Returns:
        The array; anything that already stands for one (a traced value, a shape) as it is.

    Raises:
        ValueError: The value is no number or has another shape.
    """
    if _is_array(value):
        if not _ends_in(value.shape, shape):
            raise ValueError(f"{key} must be {rule}, got an array of shape {tuple(value.shape)}.")
        if not isinstance(value, jax.Array | np.ndarray | np.generic):
            return value
        if not isinstance(value, jax.Array):
            _refuse_text(key, value, rule, value)
        whole = not jnp.issubdtype(value.dtype, jnp.inexact)
        if isinstance(value, jax.Array) and not whole:
            return value
        with jax.ensure_compile_time_eval():
            return to_device(value, jnp.result_type(float) if whole else None)
    traced = any(isinstance(x, jax.Array) for x in jax.tree.leaves(value))
    try:
        if not traced:
            _refuse_text(key, np.asarray(value), rule, value)
        array = jnp.asarray(value) if traced else np.asarray(value, float)
    except (TypeError, ValueError):
        raise ValueError(f"{key} must be {rule}, got {value!r}.") from None
    fits = len(array.shape) == len(shape) and all(
        n is None or n == m for n, m in zip(shape, array.shape, strict=True)
    )
    if not fits:
        raise ValueError(f"{key} must be {rule}, got {value!r}.")
    if traced:
        return array
    with jax.ensure_compile_time_eval():
        return to_device(array, jnp.result_type(float))


def _refuse_text(key: str, array: np.ndarray | np.generic, rule: str, value: Any) -> None:
    """Refuse what numpy would take for numbers: a text as the one it spells, None as NaN."""
    kind = array.dtype.kind
    if kind in "USmM" or (kind == "O" and any(isinstance(x, _NO_NUMBERS) for x in array.flat)):
        raise ValueError(f"{key} must be {rule}, got {value!r}.")


def _ends_in(found: tuple[int, ...], wanted: tuple[int | None, ...]) -> bool:
    """Whether the last axes of an array have the lengths that are wanted. Axes before them are
    those of a stack; within `vmap`, a single one lacks the axis of a list."""
    fixed = [length for length in wanted if length is not None]
    return len(found) >= len(fixed) and list(found[len(found) - len(fixed) :]) == fixed


def readable(module: Any) -> str:
    """The text of an object with fields: their values, without those that are None or default."""
    parts = []
    for field in dataclasses.fields(module):
        value = getattr(module, field.name, None)
        if value is None or _is_default(field, value):
            continue
        parts.append(f"{field.name}={value_text(value)}")
    name = type(module).__name__
    line = f"{name}({', '.join(parts)})"
    if len(line) <= _LINE and "\n" not in line:
        return line
    inner = "".join("\n  " + part.replace("\n", "\n  ") + "," for part in parts)
    return f"{name}({inner}\n)"


def value_text(value: Any) -> str:
    """A value of a field: numbers as they are, a large or traced array by its type and shape."""
    if not _is_array(value):
        return repr(value)
    shape = ", ".join(map(str, value.shape))
    if isinstance(value, Tracer) or not isinstance(value, jax.Array | np.ndarray):
        return f"{value.dtype}[{shape}] (traced)"
    if value.size > _SHOWN:
        return f"{value.dtype}[{shape}]"
    return _numbers_text(np.asarray(value).tolist())


def _is_default(field: dataclasses.Field, value: Any) -> bool:
    """Whether a field has the value that it has where none is given."""
    if field.default is dataclasses.MISSING or isinstance(value, Tracer):
        return False
    if not isinstance(value, jax.Array | np.ndarray):
        return value == field.default
    default = np.asarray(field.default, float)
    same_size = value.size == default.size <= _SHOWN
    return same_size and bool(np.all(np.asarray(value).ravel() == default.ravel()))


def _numbers_text(value: Any) -> str:
    if isinstance(value, list):
        return f"({', '.join(map(_numbers_text, value))})"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _is_single(value: Any) -> bool:
    """Whether a value is one number rather than a list of them."""
    return not isinstance(value, list | tuple | str | bytes) and getattr(value, "ndim", 0) == 0


def _is_array(value: Any) -> bool:
    return hasattr(value, "dtype") and hasattr(value, "shape")
