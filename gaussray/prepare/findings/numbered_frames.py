"""Whether the pictures of several folders belong together, and which are not used."""

from collections.abc import Sequence

import numpy as np

from gaussray.prepare.findings.finding import Finding
from gaussray.prepare.sources import Source
from gaussray.prepare.timeline import Timeline


def numbered_frames_findings(sources: Sequence[Source], timeline: Timeline) -> list[Finding]:
    """Pictures that are not used, and names that leave it open which pictures belong together.

    Args:
        sources: cameras of the input.
        timeline: the pictures that are used.
    """
    folders = [source for source in sources if not source.is_video]
    found, findings = timeline.numbers, []
    text, remedy = found.open_question
    if text:
        findings.append(Finding("warn", "sync", text, remedy))
    remedy = "Photographs of a still scene belong in one folder, whatever their sizes."
    left = {s.name: s.count - len(np.unique(timeline.frames[s.name])) for s in folders}
    if found.common:
        count = len(found.common)
        why = f"all folders have {count} of the numbers in their names"
        if len(folders) == len(sources):
            # Others are the user's own choice of times.
            left = {name: len(own) - count for name, own in found.times.items()}
        else:
            why += f", and {len(timeline.times)} times are used"
    else:
        if len({source.count for source in folders}) == 1:
            # It is the user's own choice of times.
            left = {}
        why = (
            "folders of pictures are cameras that take pictures at the same times, and all of them "
            f"have {len(timeline.times)}"
        )
        remedy = f"Give each folder as many. {remedy}"
    unused = ", ".join(f"{count} of {name}" for name, count in left.items() if count)
    if unused:
        text = f"pictures that are not used: {unused}; {why}"
        findings.append(Finding("warn", "sync", text, remedy))
    return findings
