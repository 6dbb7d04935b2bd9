"""HTML and SVG elements from functions; all text is escaped."""

import html
from typing import Any


VOID = ("img", "input", "meta", "br", "hr")


class Markup(str):
    """A string of HTML, which is not escaped again."""


def tag(name: str, /, *children: Any, **attributes: Any) -> Markup:
    """An element of HTML or SVG.

    Args:
        name: name of the element, such as `div`.
        children: its content: elements, values that become text, or sequences of these. All but
            `Markup` is escaped, None is left out.
        attributes: values by name, escaped; those that are None or False are left out, and True is
            an attribute without a value. `class_` becomes class, `stroke_width` stroke-width.
    """
    text = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{"" if value is True else escape(value)}"'
        for key, value in attributes.items()
        if value is not None and value is not False
    )
    if name in VOID:
        return Markup(f"<{name}{text}>")
    return Markup(f"<{name}{text}>{concatenate_markup(children)}</{name}>")


def concatenate_markup(parts: Any) -> Markup:
    """Elements one after another; nested sequences are flattened."""
    if isinstance(parts, list | tuple):
        return Markup("".join(concatenate_markup(part) for part in parts))
    if parts is None:
        return Markup("")
    return parts if isinstance(parts, Markup) else Markup(escape(parts))


def escape(value: Any) -> str:
    """A value as text with the characters of HTML escaped."""
    return html.escape(f"{value:.6g}" if isinstance(value, float) else str(value), quote=True)
