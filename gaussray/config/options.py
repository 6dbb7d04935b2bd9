"""Builds typed options from the groups of a configuration."""

import dataclasses
import math
from typing import Any, TypeVar, get_args, get_origin

import equinox as eqx
from omegaconf import OmegaConf

from gaussray.config.compose import Configuration
from gaussray.config.messages import quotes_remedy
from gaussray.config.suggest import did_you_mean


OptionsT = TypeVar("OptionsT", bound=eqx.Module)

_TYPE_NAMES = {
    int: "a whole number",
    float: "a number",
    bool: "true or false",
    tuple: "a list",
}


def build_options(kind: type[OptionsT], node: Configuration) -> OptionsT:
    """One group of a configuration becomes one options object.

    Args:
        kind: the options class, whose fields are the keys of the group and have defaults.
        node: the group's values. `null` is accepted for fields of type `X | None` alone.

    Raises:
        ValueError: A key is unknown, or a value does not have the type of its field.
    """
    values: dict[str, Any] = OmegaConf.to_container(node, resolve=True)  # type: ignore[assignment]
    fields = kind.__dataclass_fields__  # type: ignore[attr-defined]
    group = node._key() or kind.__name__
    for name, value in values.items():
        if name not in fields:
            raise ValueError(
                f"{group}.{name} is unknown; known are {', '.join(fields)}."
                f"{did_you_mean(name, fields)}"
            )
        values[name] = field_value(fields[name], value, f"{group}.{name}")
    return kind(**values)


def field_value(field: dataclasses.Field, value: Any, key: str) -> Any:
    """A YAML value as the type of a field of an options class.

    Args:
        field: the field, whose default gives the type. With the default None the value may be None,
            or of the first type in the field's annotation. A field of numbers and texts takes both,
            and so does one of texts and lists of numbers (`str | tuple[float, ...]`).
        value: the value; a list where the field is a tuple.
        key: full name of the key (`lens.fov`), for messages.

    Raises:
        ValueError: the value, or what is in its list, is of another type or not a number (nan).
    """
    types = get_args(field.type)
    if isinstance(value, list) and str in types and any(get_origin(t) is tuple for t in types):
        return tuple(_numbers(value, key))
    if isinstance(value, list) and float in types:
        value = _numbers(value, key)
    if isinstance(value, list) and str in types:
        _check_names(value, key)
    if float in types and str in types and value is not None:
        return value if isinstance(value, str) else as_type(float, value, key)
    if field.default is None and value is not None:
        return as_type(types[0], value, key)
    return as_type(type(field.default), value, key)


def _check_names(values: list[Any], key: str) -> None:
    for wrong in (x for x in values if not isinstance(x, str)):
        remedy = quotes_remedy(wrong, f"{key}=['NAME']")
        raise ValueError(f"{key} must be a list of names, got {wrong!r} in it.{remedy}")


def _numbers(values: list[Any], key: str) -> list[Any]:
    """A list whose whole numbers are floats; everything but numbers is refused."""
    for wrong in (x for x in values if type(x) not in (int, float) or math.isnan(x)):
        raise ValueError(f"{key} must be a list of numbers, got {wrong!r} in it.")
    return [float(x) if type(x) is int else x for x in values]


def as_type(kind: type, value: Any, key: str) -> Any:
    """A YAML value as a type; a list becomes a tuple, and a whole number a float.

    Args:
        kind: one of int, float, bool, str and tuple.
        value: the value as YAML gives it.
        key: full name of the key (`lens.fov`), for messages.

    Raises:
        ValueError: the value is of another type, or not a number (nan).
    """
    if kind is float and isinstance(value, float) and math.isnan(value):
        raise ValueError(f"{key} must be a number, got nan.")
    if kind is tuple and isinstance(value, list):
        return tuple(value)
    if kind is float and type(value) is int:
        return float(value)
    if type(value) is kind:
        return value
    remedy = ""
    if kind is tuple and value is not None:
        # Of how many numbers the list is, its own check says.
        more = ",..." if type(value) in (int, float) else ""
        remedy = f" Write {key}=[{value}{more}]."
    if kind is str:
        remedy = quotes_remedy(value, f"{key}='NAME'")
    raise ValueError(f"{key} must be {_TYPE_NAMES.get(kind, 'a text')}, got {value!r}.{remedy}")
