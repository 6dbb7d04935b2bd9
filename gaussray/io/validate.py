"""Checks of parameter values on the host, with messages of one form."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jax.core import Tracer


# Numbers that a message shows; of more it shows the first wrong one.
_SHOWN = 16


def require(
    key: str, value: Any, holds: Callable[[np.ndarray], Any], rule: str, remedy: str = ""
) -> None:
    """Check a parameter: raise `<key> must be <rule>, got <value>. <remedy>` unless `holds`.

    Inside `jit`, `vmap` or `grad` the value is not known and nothing is checked: build cameras on
    the host.

    Args:
        key: name of the parameter.
        value: a number or an array.
        holds: the rule, a function of the array.
        rule: the rule in words.
        remedy: what the user can do.

    Raises:
        ValueError: The rule does not hold for every element.
    """
    if isinstance(value, Tracer | jax.ShapeDtypeStruct):
        return
    array = np.asarray(value)
    good = holds(array)
    if not np.all(good):
        shown = str(array.tolist())
        if array.size > _SHOWN and np.shape(good) == array.shape:
            shown = f"{array[~good][0]:g} among {array.size:,} numbers"
        raise ValueError(f"{key} must be {rule}, got {shown}. {remedy}".rstrip())


def check_kind(key: str, value: Any, kind: type | tuple[type, ...], rule: str) -> None:
    """Raise `<key> must be <rule>, got <value>.` unless the value is of a kind.

    Args:
        key: the name of the value in messages.
        value: what was given.
        kind: its type, or the types that it may have.
        rule: what the value must be, and how to make one.
    """
    if not isinstance(value, kind):
        raise ValueError(f"{key} must be {rule}, got {value!r}.")


def check_count(key: str, value: Any, least: int, remedy: str = "") -> None:
    """Raise `<key> must be a whole number from <least>, got <value>. <remedy>` unless it is one.

    Args:
        key: the name of the value in messages.
        value: what was given; a number of numpy is one, too.
        least: the smallest that it may be.
        remedy: what the user can do.
    """
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not whole or value < least:
        raise ValueError(
            f"{key} must be a whole number from {least}, got {value!r}. {remedy}".rstrip()
        )


_KINDS: dict[type, tuple[tuple[type, ...], str]] = {
    bool: ((bool, np.bool_), "true or false"),
    int: ((int, np.integer), "a whole number"),
    float: ((int, float, np.integer, np.floating), "a number"),
    str: ((str,), "a text"),
}


def check_field_types(group: str, options: Any) -> None:
    """Raise `<group>.<field> must be <kind>, got <value>.` unless each field has the type of its
    default.

    Args:
        group: what messages call the options.
        options: a dataclass; fields whose default is no number and no text are not checked.
    """
    for field in dataclasses.fields(options):
        if type(field.default) in _KINDS:
            kinds, rule = _KINDS[type(field.default)]
            value = getattr(options, field.name)
            truth = isinstance(value, bool) and bool not in kinds
            if truth or not isinstance(value, kinds):
                raise ValueError(f"{group}.{field.name} must be {rule}, got {value!r}.")


def known(*values: Any) -> bool:
    """Whether all values are numbers rather than traced placeholders or shapes."""
    return not any(isinstance(value, Tracer | jax.ShapeDtypeStruct) for value in values)


def changed_fields(options: Any) -> list[str]:
    """Names of the fields of options that differ from their defaults."""
    fields = dataclasses.fields(options)
    return [field.name for field in fields if getattr(options, field.name) != field.default]
