"""What was measured as one page to look at: figures and tables, without a network."""

import base64
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from gaussray.io.atomic import atomic_path
from gaussray.report.markup import Markup, tag
from gaussray.report.page import Section, html_page, html_table


TITLES = {
    "effects": "Frames per second of each effect, and the paper's",
    "scaling": "How the cost of a frame grows",
    "trade": "What a shortcut costs",
}


def write_page(
    out: Path,
    lines: Sequence[dict[str, Any]],
    columns: Mapping[str, Sequence[str]],
    cell: Callable[[dict[str, Any], str], str],
) -> Path:
    """Write `out`/report.html: the figures that are in `out`, and a table for each bench and
    device; `cell` says what stands in a line's column."""
    figures = [
        tag("figure", tag("h3", title), _figure(out / f"{name}.png"), class_="panel")
        for name, title in TITLES.items()
        if (out / f"{name}.png").is_file()
    ]
    sections: list[Section | None] = [Section("Figures", figures)]
    for bench, names in columns.items():
        body: list[Markup] = []
        own = [line for line in lines if line["bench"] == bench]
        for device in dict.fromkeys(line["device"] for line in own):
            some = [line for line in own if line["device"] == device]
            commits = ", ".join(dict.fromkeys(str(line["git"]) for line in some))
            heads = [name.replace("_", " ") for name in names]
            rows = [[cell(line, name) for name in names] for line in some]
            body += [tag("h3", f"{device} ({commits})"), html_table(heads, rows)]
        sections.append(Section(bench.replace("_", " "), body))
    path = out / "report.html"
    with atomic_path(path) as partial:
        partial.write_text(html_page("Benchmarks", str(out), sections), encoding="utf-8")
    return path


def _figure(path: Path) -> Markup:
    data = base64.b64encode(path.read_bytes()).decode()
    style = "width:100%;border-radius:6px;background:#fff"
    return tag("img", src=f"data:image/png;base64,{data}", alt=TITLES[path.stem], style=style)
