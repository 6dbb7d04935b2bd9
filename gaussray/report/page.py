"""The report's HTML page: one self-contained file with light and dark colours."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from gaussray.report.markup import Markup, concatenate_markup, tag


STYLE = (Path(__file__).parent / "page.css").read_text()
SCRIPT = (Path(__file__).parent / "page.js").read_text()
# The page loads nothing from elsewhere, whatever names in it contain.
POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"


class Section(NamedTuple):
    """A part of the page with its title in the navigation."""

    title: str
    body: Sequence[Any]


def html_page(title: str, subtitle: str, sections: Sequence[Section | None]) -> str:
    """The HTML of a page.

    Args:
        title, subtitle: heading of the page and the line below it.
        sections: parts of the page, in order; None and empty ones are left out.
    """
    visible = [section for section in sections if section is not None and any(section.body)]
    links = [tag("a", one.title, href=f"#part-{i}") for i, one in enumerate(visible)]
    parts = [
        tag("section", tag("h2", one.title), list(one.body), id=f"part-{i}")
        for i, one in enumerate(visible)
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


def summary_tiles(rows: Sequence[tuple[str, str, str]]) -> Markup:
    """The most important figures as tiles: (name, value, unit or remark)."""
    cells = [
        tag("div", tag("dt", name), tag("dd", value, tag("small", f" {unit}") if unit else None))
        for name, value, unit in rows
    ]
    return tag("dl", cells, class_="tiles")


def html_table(heads: Sequence[str], rows: Sequence[Sequence[Any]], *, text: int = 1) -> Markup:
    """A table.

    Args:
        heads: heading of each column.
        rows: cells of each row.
        text: number of leading columns with words; the others hold figures, aligned right.
    """

    def cells(kind: str, row: Sequence[Any]) -> list[Markup]:
        return [tag(kind, x, class_="word" if i < text else None) for i, x in enumerate(row)]

    body = [tag("tr", cells("td", row)) for row in rows]
    table = tag("table", tag("thead", tag("tr", cells("th", heads))), tag("tbody", body))
    return tag("div", table, class_="wide")


def definition_list(pairs: Sequence[tuple[str, Any]]) -> Markup:
    """Names and values, line by line."""
    return tag("dl", [[tag("dt", name), tag("dd", x)] for name, x in pairs], class_="facts")


def note(text: str) -> Markup:
    """A remark below a drawing or a table."""
    return tag("p", text, class_="note")


def collapsible(title: str, *body: Any) -> Markup:
    """Content that opens when its title is clicked.

    Args:
        title: the line that is always visible.
        body: the content, as the children of `tag`.
    """
    return tag("details", tag("summary", title), concatenate_markup(body))
