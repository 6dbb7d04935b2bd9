"""HTML and SVG from functions: what is text becomes text, whoever wrote it."""

import html
from typing import Any


VOID = ("img", "input", "meta", "br", "hr")


class Markup(str):
    """Text that is markup already."""


def tag(name: str, /, *children: Any, **attributes: Any) -> Markup:
    """An element. Children and values that are no `Markup` are escaped; None and False are left
    out. `class_` is class, `stroke_width` is stroke-width."""
    told = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{"" if value is True else escape(value)}"'
        for key, value in attributes.items()
        if value is not None and value is not False
    )
    if name in VOID:
        return Markup(f"<{name}{told}>")
    return Markup(f"<{name}{told}>{joined(children)}</{name}>")


def joined(parts: Any) -> Markup:
    """Elements one after another; sequences within them are flattened."""
    if isinstance(parts, list | tuple):
        return Markup("".join(joined(part) for part in parts))
    if parts is None:
        return Markup("")
    return parts if isinstance(parts, Markup) else Markup(escape(parts))


def escape(value: Any) -> str:
    """A value as text in which no sign means anything."""
    return html.escape(f"{value:.6g}" if isinstance(value, float) else str(value), quote=True)
