"""Draws values from distributions, each by the name of its key: no draw depends on another."""

import hashlib
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np


# The kinds of distribution, each with the keys that it may have beside its own.
EXTRA_KEYS = {
    "uniform": (),
    "log_uniform": (),
    "integer": (),
    "normal": ("within",),
    "choice": ("weights",),
    "each": (),
}
# From the name of a key to its number in (0, 1).
UniformNumbers = Callable[[str], float]


def uniform_number(seed: int, index: int, attempt: int, key: str) -> float:
    """The number in (0, 1) of a key, for one attempt at the sample of one index.

    It is 52 bits of the SHA-256 of the four arguments: equal on every machine, independent of the
    order and of all other keys. Adding a key leaves the numbers of the others as they are.
    """
    digest = hashlib.sha256(f"{seed}/{index}/{attempt}/{key}".encode()).digest()
    return ((int.from_bytes(digest[:8], "big") >> 12) + 0.5) * 2.0**-52


def read_distributions(tree: Mapping[str, Any], name: str = "sample") -> dict[str, dict[str, Any]]:
    """The checked distribution of every key, from a tree that is nested as the keys are.

    A node with one of the words of `EXTRA_KEYS` is a distribution. Beside the `choice` of a whole
    group there may be distributions of the group's keys. A ValueError names what is wrong.
    """
    found: dict[str, dict[str, Any]] = {}
    _gather(tree, "", name, found)
    return found


def draw_values(
    seed: int, index: int, attempt: int, specs: Mapping[str, Mapping[str, Any]]
) -> dict:
    """A value for every key, at one attempt for the sample of an index."""
    return {
        key: draw_value(spec, lambda name: uniform_number(seed, index, attempt, name), key)
        for key, spec in specs.items()
    }


def draw_value(spec: Any, u: UniformNumbers, key: str) -> Any:
    """The value of a checked distribution at the uniform numbers u; a fixed value is returned as it
    is.

    The cumulative distribution is inverted, x = F^-1(u), with u(key), or u(key[i]) for the elements
    of `each`.

    uniform: [a, b]          a + (b - a) u
    log_uniform: [a, b]      a (b / a)^u: every octave is equally likely
    integer: [a, b]          whole numbers from a to b, both included
    normal: [mean, deviation], within: [a, b]    truncated to a ... b, if given
    choice: [...], weights: [...]     one of these, equally likely without weights
    each: [...]              a list; each element is a distribution or a fixed value
    """
    match spec:
        case {"uniform": [a, b]}:
            return float(min(a + (b - a) * u(key), b))
        case {"log_uniform": [a, b]}:
            return float(min(max(a * (b / a) ** u(key), a), b))
        case {"integer": [a, b]}:
            return int(a + math.floor((b - a + 1) * u(key)))
        case {"normal": [mean, deviation]}:
            low, high = spec.get("within", (-math.inf, math.inf))
            return _normal(mean, deviation, low, high, u(key))
        case {"choice": list(values)}:
            weights = np.cumsum(spec.get("weights", [1.0] * len(values)))
            return values[int(np.searchsorted(weights / weights[-1], u(key), side="right"))]
        case {"each": list(elements)}:
            return [draw_value(x, u, f"{key}[{i}]") for i, x in enumerate(elements)]
    return spec


def _normal(mean: float, deviation: float, low: float, high: float, u: float) -> float:
    if deviation == 0:
        return float(mean)
    a, b = (low - mean) / deviation, (high - mean) / deviation
    if a > 0:
        # 1 - F is lost in rounding in the upper tail: mirror it to the lower one.
        a, b, deviation, u = -b, -a, -deviation, 1 - u
    # Imported here: that takes a tenth of a second, which a plain render does not need.
    from scipy.special import ndtr, ndtri

    place = ndtri(ndtr(a) + (ndtr(b) - ndtr(a)) * u)
    return float(min(max(mean + deviation * place, low), high))


def _gather(node: Any, key: str, name: str, found: dict[str, dict[str, Any]]) -> None:
    label = f"{name}.{key}" if key else name
    if not isinstance(node, Mapping):
        raise ValueError(
            f"{label} must be a distribution, such as uniform: [0, 1] or choice: [a, b], got "
            f"{node!r}. A fixed value needs no {name}: write the key alone."
        )
    kinds = [word for word in node if word in EXTRA_KEYS]
    if len(kinds) > 1:
        raise ValueError(
            f"{label} must be one distribution, got {' and '.join(kinds)}: remove the others, "
            f"e.g. ~{label}.{kinds[0]}."
        )
    own = (*kinds, *EXTRA_KEYS[kinds[0]]) if kinds else ()
    if kinds:
        found[key] = {word: node[word] for word in own if word in node}
        check_distribution(found[key], label)
    for word, below in node.items():
        if word in own:
            continue
        if kinds and kinds[0] != "choice":
            raise ValueError(
                f"{label}.{word} is unknown; beside {kinds[0]} may stand "
                f"{' or '.join(EXTRA_KEYS[kinds[0]]) or 'nothing'}."
            )
        _gather(below, f"{key}.{word}" if key else str(word), name, found)


def check_distribution(spec: Mapping[str, Any], label: str) -> None:
    """Raise a ValueError, with key and rule, unless the distribution is one."""
    (kind,) = (word for word in spec if word in EXTRA_KEYS)
    given, label = spec[kind], f"{label}.{kind}"

    def demand(holds: bool, rule: str) -> None:
        if not holds:
            raise ValueError(f"{label} must be {rule}, got {given}.")

    match kind:
        case "uniform":
            demand(_pair(given), "two numbers, the lower one first")
        case "log_uniform":
            demand(_pair(given) and given[0] > 0, "two numbers above 0, the lower one first")
        case "integer":
            whole = _pair(given) and all(type(x) is int for x in given)
            demand(whole, "two whole numbers, the lower one first")
        case "normal":
            demand(_numbers(given, 2) and given[1] >= 0, "a mean, and a deviation of at least 0")
            _check_within(given, spec.get("within"), label.removesuffix(kind) + "within")
        case "choice":
            demand(isinstance(given, list) and len(given) > 0, "a list of at least one value")
            _check_weights(given, spec.get("weights"), label.removesuffix(kind) + "weights")
        case "each":
            demand(isinstance(given, list), "a list of distributions and fixed values")
            for i, element in enumerate(given):
                if isinstance(element, Mapping):
                    found: dict[str, dict[str, Any]] = {}
                    _gather(element, f"{i}", label, found)
                    demand(f"{i}" in found, "a list of distributions and fixed values")


def _check_within(bell: list[float | int], within: Any, label: str) -> None:
    if within is None:
        return
    if not _pair(within):
        raise ValueError(f"{label} must be two numbers, the lower one first, got {within}.")
    mean, deviation = bell
    away = max(within[0] - mean, mean - within[1])
    # A double has no smaller share of a bell than that beyond 37 deviations.
    if away > 37 * deviation:
        raise ValueError(
            f"{label} must hold a part of the bell around {mean} +- {deviation}, got {within}."
        )


def _check_weights(values: list[Any], weights: Any, label: str) -> None:
    if weights is None:
        return
    good = _numbers(weights, len(values)) and min(weights) >= 0 and sum(weights) > 0
    if not good:
        raise ValueError(
            f"{label} must be {len(values)} numbers of at least 0, one for each choice and not all "
            f"0, got {weights}."
        )


def _numbers(given: Any, count: int) -> bool:
    return (
        isinstance(given, list)
        and len(given) == count
        and all(type(x) in (int, float) and math.isfinite(x) for x in given)
    )


def _pair(given: Any) -> bool:
    return _numbers(given, 2) and given[0] <= given[1]
