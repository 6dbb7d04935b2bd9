"""One result of a check of the input."""

from collections.abc import Iterable
from typing import NamedTuple

from gaussray.runtime.output import first_of


# Names of cameras that share a finding which are listed, at most.
_LISTED = 8


class Finding(NamedTuple):
    """One result of a check.

    Args:
        level: `good`, `warn` or `refuse`.
        subject: what it is about: sync, cameras, lens, points, epipolar lines, exposure.
        text: what was found.
        remedy: what to do about it; empty if nothing.
    """

    level: str
    subject: str
    text: str
    remedy: str = ""


def merged_findings(findings: Iterable[Finding]) -> list[Finding]:
    """The findings, one for all cameras of which several say the same after "NAME: ".

    A text of no camera may hold ": " as well: without others that end alike it stays as it is.
    """
    names: dict[Finding, list[str]] = {}
    for finding in findings:
        name, colon, same = finding.text.partition(": ")
        names.setdefault(finding._replace(text=colon + same or name), []).append(name)
    merged = []
    for finding, own in names.items():
        if finding.text.startswith(": "):
            finding = finding._replace(text=first_of(own, _LISTED) + finding.text)
        merged.append(finding)
    return merged


def doubts_text(findings: Iterable[Finding]) -> str:
    """What is doubtful and what to do about it, a line for each; empty if nothing is."""
    doubtful = [finding for finding in findings if finding.level != "good"]
    lines = [f"- {x.subject}: {x.text}. {x.remedy}".rstrip() for x in doubtful]
    return "\n".join([f"{len(doubtful)} doubtful:", *lines]) if doubtful else ""
