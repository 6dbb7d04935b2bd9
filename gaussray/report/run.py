"""Sections of every report: how to reproduce the run, what it ran with, how long it took."""

import json
from pathlib import Path
from typing import Any

from gaussray.report.markup import Markup, tag
from gaussray.report.page import Section, collapsible, definition_list, note
from gaussray.runtime.provenance import command, run_record


def subtitle(out: Path) -> str:
    """The run's folder and start time."""
    record = run_record(out)
    began = str(record.get("began", "")).replace("T", " ")[:16]
    return " · ".join(filter(None, (str(out), began)))


def how_to_reproduce(out: Path, timings: list[tuple[str, Any]]) -> Section:
    """The command, git commit, package versions, durations and resolved configuration of a run.

    Args:
        out: the run's folder, with run.json and config.yaml.
        timings: name and duration, as text, of each part of the run; the total follows them.
    """
    record, body = run_record(out), list[Any]()
    line = record.get("command") or command()
    if line:
        body += [tag("h3", "Command"), tag("pre", line, class_="command")]
    changed = ", with uncommitted changes" if record.get("changed") else ""
    code = [("commit", record["git"] + changed)] if "git" in record else []
    versions = record.get("versions", {})
    packages = ", ".join(f"{name} {x}" for name, x in versions.items() if name != "device")
    pairs = [*code, ("packages", packages), ("python", record.get("python"))]
    pairs += [("device", versions.get("device"))]
    pairs = [(name, x) for name, x in pairs if x]
    body += [tag("h3", "Made with"), definition_list(pairs)] if pairs else []
    timings = [*timings, *([("total", duration(record["seconds"]))] if "seconds" in record else [])]
    if timings:
        body += [tag("h3", "Time"), definition_list(timings)]
    body.append(configuration_text(out))
    return Section("Reproduce", body)


def configuration_text(out: Path) -> Markup:
    """The content of config.yaml, collapsed."""
    try:
        text = (out / "config.yaml").read_text()
    except OSError:
        return note("There is no config.yaml.")
    return collapsible("Resolved configuration (config.yaml)", tag("pre", text))


def duration(seconds: float | int) -> str:
    """A duration in seconds, minutes or hours."""
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s"


def file_size(count: float | int) -> tuple[str, str]:
    """A number of bytes as a figure and its unit."""
    return (f"{count / 1e6:.3g}", "MB") if count >= 1e5 else (f"{count / 1e3:.3g}", "kB")


def json_lines(path: Path) -> list[dict[str, Any]]:
    """Records of a JSON lines file; invalid lines are left out; none if the file is missing."""
    records = []
    try:
        text = path.read_text()
    except OSError:
        return []
    for line in text.splitlines():
        try:
            records.append(json.loads(line))
        except ValueError:
            continue
    return records


def json_document(path: Path) -> dict[str, Any]:
    """The content of a JSON file; empty if it is missing or invalid."""
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError):
        return {}
