"""What is swept through float32: a function, a range of one input, and how inputs are drawn.

Inputs are drawn in double precision and then rounded: what is left after that is what the function
is given in both precisions. So an error is the function's own, not that of its inputs.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np


# Inputs drawn at each place of a range.
DRAWS = 12
# Inputs that go through a function at once: one program for all sweeps of it.
BATCH = 256
# Half a unit in the last place of float32.
HALF_ULP = 2.0**-24
# Below this float32 has fewer digits, or none: a CPU or GPU may take it for zero.
LEAST, MOST = 1e-36, 3e38


class Sweep(NamedTuple):
    """`function` of a tree of inputs, along `places` of what is `swept`.

    `draw(place, dice)` gives the inputs; `exact` is another formula for the value where the
    function's own takes shortcuts that double precision would share.
    """

    group: str
    name: str
    swept: str
    places: np.ndarray
    draw: Callable[[float, np.random.Generator], Any]
    function: Callable[..., Any]
    exact: Callable[..., np.ndarray] | None = None


class Errors(NamedTuple):
    """Largest relative errors at every place: of the value and of the gradient, and how far both
    move when every input moves by half a unit in the last place (`*_inputs`)."""

    value: np.ndarray
    gradient: np.ndarray
    value_inputs: np.ndarray
    gradient_inputs: np.ndarray


def decades(low: float, high: float, each: int = 2) -> np.ndarray:
    """So many places in each decade, both ends included."""
    return np.geomspace(low, high, round(each * np.log10(high / low)) + 1)


def measure(sweep: Sweep) -> Errors:
    """Errors of float32 along a sweep."""
    dice = np.random.default_rng(0)
    drawn = [sweep.draw(place, dice) for place in sweep.places for _ in range(DRAWS)]
    single = jax.tree.map(lambda *x: np.stack(x).astype(np.float32), *drawn)
    double = jax.tree.map(lambda x: x.astype(np.float64), single)
    inputs = single, double, _nudged(double, dice)
    found, own, moved = (_run(sweep.function, x) for x in inputs)
    truth = own
    if sweep.exact is not None:
        values = [
            sweep.exact(*jax.tree.map(lambda x, i=i: x[i], double)) for i in range(len(drawn))
        ]
        truth = np.stack(values), truth[1]
    value, gradient = (_apart(a, b) for a, b in zip(found, truth, strict=True))
    aside = [_apart(a, b) for a, b in zip(moved, own, strict=True)]
    return Errors(*(x.reshape(-1, DRAWS).max(axis=1) for x in (value, gradient, *aside)))


def _run(function: Callable, inputs) -> tuple[np.ndarray, np.ndarray]:
    """Values and gradients of all inputs, BATCH at a time; the last ones fill up what is left."""
    count, run = len(jax.tree.leaves(inputs)[0]), _compiled(function)
    parts = []
    for start in range(0, count, BATCH):
        chosen = np.minimum(np.arange(start, start + BATCH), count - 1)
        parts.append(run(*jax.tree.map(lambda x, chosen=chosen: x[chosen], inputs)))
    value, gradient = (np.concatenate(x)[:count] for x in zip(*parts, strict=True))
    return value, gradient


@functools.cache
def _compiled(function: Callable) -> Callable:
    return jax.jit(jax.vmap(_both(function)))


def _both(function: Callable) -> Callable:
    """Value as one vector, and the gradient of a random mean of it in natural units: what a change
    by a share of each input's size does."""

    def run(*inputs):
        value, pull = jax.vjp(lambda *x: _flat(function(*x)), *inputs)
        weight = np.random.default_rng(1).normal(size=value.shape)
        slope = pull(jnp.asarray(weight, value.dtype))
        # Sizes in double precision, in which they do not round; they are the same for both.
        natural = jax.tree.map(
            lambda g, x: g.astype(jnp.float64) * jnp.maximum(jnp.max(jnp.abs(x)), LEAST),
            slope,
            inputs,
        )
        return value, _flat(natural)

    return run


def _flat(tree) -> jax.Array:
    return jnp.concatenate([jnp.ravel(x) for x in jax.tree.leaves(tree)])


def _nudged(inputs, dice):
    return jax.tree.map(lambda x: x * (1 + HALF_ULP * dice.choice([-1.0, 1.0], x.shape)), inputs)


def _apart(found, truth) -> np.ndarray:
    """Relative error of every vector: infinite where float32 has no finite one though there is
    one that it could hold; 0 where it could not."""
    found, truth = np.asarray(found, np.float64), np.asarray(truth, np.float64)
    size = np.linalg.norm(truth, axis=-1)
    with np.errstate(all="ignore"):
        error = np.linalg.norm(found - truth, axis=-1) / np.maximum(size, LEAST)
    error = np.where(np.isfinite(error), error, np.inf)
    return np.where((size < MOST) & np.isfinite(size) & (size > LEAST), error, 0)
