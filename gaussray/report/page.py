"""The page around its sections: one file that needs no other, in light and in dark."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from gaussray.report.markup import Markup, joined, tag


STYLE = (Path(__file__).parent / "page.css").read_text()
SCRIPT = (Path(__file__).parent / "page.js").read_text()
# Nothing is fetched, whatever a name in the page says.
POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"


class Section(NamedTuple):
    """A part of a page, with the name that leads to it."""

    title: str
    body: Sequence[Any]


def page(title: str, subtitle: str, sections: Sequence[Section | None]) -> str:
    """A page of the sections that there are."""
    shown = [section for section in sections if section is not None and any(section.body)]
    links = [tag("a", one.title, href=f"#part-{i}") for i, one in enumerate(shown)]
    parts = [
        tag("section", tag("h2", one.title), list(one.body), id=f"part-{i}")
        for i, one in enumerate(shown)
    ]
    head = [
        tag("meta", charset="utf-8"),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("meta", name="color-scheme", content="light dark"),
        Markup(f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'),
        tag("title", f"{title} · gaussray"),
        tag("style", Markup(STYLE)),
    ]
    top = tag(
        "header",
        tag("p", "gaussray", class_="brand"),
        tag("h1", title),
        tag("p", subtitle, class_="subtitle"),
        tag("nav", links),
    )
    body = [top, tag("main", parts), tag("script", Markup(SCRIPT))]
    return f"<!doctype html>\n{tag('html', tag('head', head), tag('body', body), lang='en')}\n"


def tiles(facts: Sequence[tuple[str, str, str]]) -> Markup:
    """Figures to be seen first: (what it is, value, unit or remark)."""
    cells = [
        tag("div", tag("dt", name), tag("dd", value, tag("small", f" {unit}") if unit else None))
        for name, value, unit in facts
    ]
    return tag("dl", cells, class_="tiles")


def table(heads: Sequence[str], rows: Sequence[Sequence[Any]], *, text: int = 1) -> Markup:
    """Rows of cells, of which the first `text` are words and the others figures."""

    def cells(kind: str, row: Sequence[Any]) -> list[Markup]:
        return [tag(kind, x, class_="word" if i < text else None) for i, x in enumerate(row)]

    body = [tag("tr", cells("td", row)) for row in rows]
    whole = tag("table", tag("thead", tag("tr", cells("th", heads))), tag("tbody", body))
    return tag("div", whole, class_="wide")


def facts(pairs: Sequence[tuple[str, Any]]) -> Markup:
    """Names with what they stand for, line by line."""
    return tag("dl", [[tag("dt", name), tag("dd", x)] for name, x in pairs], class_="facts")


def note(text: str) -> Markup:
    """A remark below a drawing or a table."""
    return tag("p", text, class_="note")


def folded(title: str, *body: Any) -> Markup:
    """What is shown when it is asked for."""
    return tag("details", tag("summary", title), joined(body))
