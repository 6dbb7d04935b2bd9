"""What every page says of its run: how to do it again, with what it was done, how long it took."""

import json
from pathlib import Path
from typing import Any

from gaussray.report.markup import Markup, tag
from gaussray.report.page import Section, facts, folded, note
from gaussray.runtime.provenance import command, noted


def subtitle(out: Path) -> str:
    """Where the files are, and when they were made."""
    told = noted(out)
    began = str(told.get("began", "")).replace("T", " ")[:16]
    return " · ".join(filter(None, (str(out), began)))


def reproduce(out: Path, timings: list[tuple[str, Any]]) -> Section:
    """The command, the code, its packages, the times, and the configuration that was resolved."""
    told, body = noted(out), list[Any]()
    asked = told.get("command") or command()
    if asked:
        body += [tag("h3", "Command"), tag("pre", asked, class_="command")]
    changed = ", with changes" if told.get("changed") else ""
    code = [("commit", told["git"] + changed)] if "git" in told else []
    versions = told.get("versions", {})
    packages = ", ".join(f"{name} {x}" for name, x in versions.items() if name != "device")
    pairs = [*code, ("packages", packages), ("python", told.get("python"))]
    pairs += [("device", versions.get("device"))]
    pairs = [(name, x) for name, x in pairs if x]
    body += [tag("h3", "Made with"), facts(pairs)] if pairs else []
    timings = [*timings, *([("in all", clock(told["seconds"]))] if "seconds" in told else [])]
    if timings:
        body += [tag("h3", "Time"), facts(timings)]
    body.append(configuration(out))
    return Section("Do it again", body)


def configuration(out: Path) -> Markup:
    """config.yaml, on request."""
    try:
        text = (out / "config.yaml").read_text()
    except OSError:
        return note("There is no config.yaml.")
    return folded("The configuration, every key resolved", tag("pre", text))


def clock(seconds: float | int) -> str:
    """Seconds as people say them."""
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s"


def size(count: float | int) -> tuple[str, str]:
    """Bytes as a figure and its unit."""
    return (f"{count / 1e6:.3g}", "MB") if count >= 1e5 else (f"{count / 1e3:.3g}", "kB")


def lines(path: Path) -> list[dict[str, Any]]:
    """JSON lines of a file, those that are whole; none if it is not there."""
    found = []
    try:
        text = path.read_text()
    except OSError:
        return []
    for line in text.splitlines():
        try:
            found.append(json.loads(line))
        except ValueError:
            continue
    return found


def document(path: Path) -> dict[str, Any]:
    """A JSON document; nothing if it is not there."""
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError):
        return {}
