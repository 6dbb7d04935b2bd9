"""`jnp.asarray`, `jnp.zeros` and the like without a compiled program: made by numpy, then put."""

import functools
import numbers
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax._src.core import trace_ctx


def install() -> None:
    """Replace the functions of `jax.numpy` that make arrays of numbers of the host."""
    for name in ("array", "asarray"):
        setattr(jnp, name, _converted(getattr(jnp, name)))
    for name in ("zeros", "ones"):
        setattr(jnp, name, _filled(getattr(jnp, name), getattr(np, name)))
        like = f"{name}_like"
        setattr(jnp, like, _filled_like(getattr(jnp, like), getattr(np, name)))


def _eager() -> bool:
    """Whether nothing is traced or differentiated."""
    return trace_ctx.is_top_level()


def _put(value: Any, dtype: Any) -> jax.Array:
    """An array of its own memory, in the precision that JAX would give it."""
    if dtype is None:
        dtype = np.asarray(value).dtype
    with np.errstate(all="ignore"):
        return jax.device_put(np.array(value, jax.dtypes.canonicalize_dtype(dtype)))


def _of_host(value: Any, dtype: Any) -> bool:
    """Whether a value consists of numbers of the host, and has a type of its own: that of Python's
    numbers gives way to that of what they meet."""
    if isinstance(value, np.ndarray | np.generic):
        return value.dtype.kind in "fiub"
    if isinstance(value, numbers.Real):
        return dtype is not None
    return isinstance(value, list | tuple) and len(value) > 0 and all(map(_plain, value))


def _uncommitted(array: Any) -> bool:
    """Whether it is an array on no device in particular, with a type of its own."""
    traced = isinstance(array, jax.core.Tracer)
    return isinstance(array, jax.Array) and not (traced or array.weak_type or array.committed)


def _plain(value: Any) -> bool:
    if isinstance(value, list | tuple):
        return all(map(_plain, value))
    return isinstance(value, float | int | bool | np.floating | np.integer | np.bool_)


def _converted(function: Callable) -> Callable:
    @functools.wraps(function)
    def convert(value: Any, dtype: Any = None, **rest: Any) -> jax.Array:
        if not rest and _eager() and _of_host(value, dtype):
            try:
                return _put(value, dtype)
            except (OverflowError, TypeError, ValueError):
                pass  # JAX's own message
        return function(value, dtype, **rest)

    return convert


def _filled(function: Callable, fill: Callable) -> Callable:
    @functools.wraps(function)
    def make(shape: Any, dtype: Any = None, **rest: Any) -> jax.Array:
        if not rest and _eager():
            return _put(fill(shape), float if dtype is None else dtype)
        return function(shape, dtype, **rest)

    return make


def _filled_like(function: Callable, fill: Callable) -> Callable:
    @functools.wraps(function)
    def make(array: Any, dtype: Any = None, **rest: Any) -> jax.Array:
        if not rest and _eager() and _uncommitted(array) and array.dtype.kind in "fiub":
            return _put(fill(array.shape), array.dtype if dtype is None else dtype)
        return function(array, dtype, **rest)

    return make
