"""Draws values from distributions. The draw of a key does not depend on other keys."""

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
    order and of all other keys. Adding a key does not change the numbers of the others.

    Args:
        seed: random seed.
        index: index of the sample.
        attempt: number of the attempt, from 0.
        key: name of the key.
    """
    digest = hashlib.sha256(f"{seed}/{index}/{attempt}/{key}".encode()).digest()
    return ((int.from_bytes(digest[:8], "big") >> 12) + 0.5) * 2.0**-52


def read_distributions(tree: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Read and check the distributions of a configuration: its keys below `sample`.

    A node with one of the words of `EXTRA_KEYS` is a distribution. Beside the `choice` of a whole
    group there may be distributions of the group's keys.

    Args:
        tree: a tree that is nested as the keys are.

    Returns:
        The distribution of every key.

    Raises:
        ValueError: A distribution is malformed; the message names its key.
    """
    distributions: dict[str, dict[str, Any]] = {}
    _collect(tree, "", "sample", distributions)
    return distributions


def draw_values(
    seed: int, index: int, attempt: int, specs: Mapping[str, Mapping[str, Any]]
) -> dict:
    """Draw a value for every key.

    Args:
        seed: random seed.
        index: index of the sample.
        attempt: number of the attempt, from 0.
        specs: distribution of every key.
    """
    return {
        key: draw_value(spec, lambda name: uniform_number(seed, index, attempt, name), key)
        for key, spec in specs.items()
    }


def draw_value(spec: Any, u: UniformNumbers, key: str) -> Any:
    """Draw a value from a checked distribution; a fixed value is returned as it is.

    The cumulative distribution is inverted, x = F^-1(u), with u(key), or u(key[i]) for the elements
    of `each`.

    uniform: [a, b]          a + (b - a) u
    log_uniform: [a, b]      a (b / a)^u: every octave is equally likely
    integer: [a, b]          whole numbers from a to b, both included
    normal: [mean, deviation], within: [a, b]    truncated to a ... b, if given
    choice: [...], weights: [...]     one of these, equally likely without weights
    each: [...]              a list; each element is a distribution or a fixed value

    Args:
        spec: the distribution, which `check_distribution` accepts, or the fixed value.
        u: gives the number in (0, 1) of a name.
        key: name of the key whose value is drawn.
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


def _collect(node: Any, key: str, name: str, distributions: dict[str, dict[str, Any]]) -> None:
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
    own_keys = (*kinds, *EXTRA_KEYS[kinds[0]]) if kinds else ()
    if kinds:
        distributions[key] = {word: node[word] for word in own_keys if word in node}
        check_distribution(distributions[key], label)
    for word, below in node.items():
        if word in own_keys:
            continue
        if kinds and kinds[0] != "choice":
            raise ValueError(
                f"{label}.{word} is unknown; beside {kinds[0]} may stand "
                f"{' or '.join(EXTRA_KEYS[kinds[0]]) or 'nothing'}."
            )
        _collect(below, f"{key}.{word}" if key else str(word), name, distributions)


def check_distribution(spec: Mapping[str, Any], label: str) -> None:
    """Check a distribution.

    Args:
        spec: the distribution.
        label: its key, for messages.

    Raises:
        ValueError: It is malformed; the message names key and rule.
    """
    (kind,) = (word for word in spec if word in EXTRA_KEYS)
    value, label = spec[kind], f"{label}.{kind}"

    def require_rule(holds: bool, rule: str) -> None:
        if not holds:
            raise ValueError(f"{label} must be {rule}, got {value}.")

    match kind:
        case "uniform":
            require_rule(_pair(value), "two numbers, the lower one first")
        case "log_uniform":
            require_rule(_pair(value) and value[0] > 0, "two numbers above 0, the lower one first")
        case "integer":
            whole = _pair(value) and all(type(x) is int for x in value)
            require_rule(whole, "two whole numbers, the lower one first")
        case "normal":
            require_rule(
                _numbers(value, 2) and value[1] >= 0, "a mean, and a deviation of at least 0"
            )
            _check_within(value, spec.get("within"), label.removesuffix(kind) + "within")
        case "choice":
            require_rule(isinstance(value, list) and len(value) > 0, "a list of at least one value")
            _check_weights(value, spec.get("weights"), label.removesuffix(kind) + "weights")
        case "each":
            require_rule(isinstance(value, list), "a list of distributions and fixed values")
            for i, element in enumerate(value):
                if isinstance(element, Mapping):
                    distributions: dict[str, dict[str, Any]] = {}
                    _collect(element, f"{i}", label, distributions)
                    require_rule(
                        f"{i}" in distributions, "a list of distributions and fixed values"
                    )


def _check_within(bell: list[float | int], within: Any, label: str) -> None:
    if within is None:
        return
    if not _pair(within):
        raise ValueError(f"{label} must be two numbers, the lower one first, got {within}.")
    mean, deviation = bell
    distance = max(within[0] - mean, mean - within[1])
    # A double has no smaller share of a bell than that beyond 37 deviations.
    if distance > 37 * deviation:
        raise ValueError(
            f"{label} must hold a part of the bell around {mean} +- {deviation}, got {within}."
        )


def _check_weights(values: list[Any], weights: Any, label: str) -> None:
    if weights is None:
        return
    valid = _numbers(weights, len(values)) and min(weights) >= 0 and sum(weights) > 0
    if not valid:
        raise ValueError(
            f"{label} must be {len(values)} numbers of at least 0, one for each choice and not all "
            f"0, got {weights}."
        )


def _numbers(value: Any, count: int) -> bool:
    return (
        isinstance(value, list)
        and len(value) == count
        and all(type(x) in (int, float) and math.isfinite(x) for x in value)
    )


def _pair(value: Any) -> bool:
    return _numbers(value, 2) and value[0] <= value[1]
