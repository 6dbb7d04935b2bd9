"""Whether a camera that starts late or stops early leaves much of the other cameras' time out."""

from collections.abc import Sequence

import numpy as np

from gaussray.prepare.findings.finding import Finding
from gaussray.prepare.sources import Source
from gaussray.prepare.timeline import Timeline
from gaussray.runtime.output import first_of


# Share of the time that half of the cameras have from which on it is missed. People who start
# cameras by hand lose a few seconds of a minute, and know it.
_SHARE = 0.1
# Names that are listed, at most.
_LISTED = 8


def common_time_findings(sources: Sequence[Source], timeline: Timeline) -> list[Finding]:
    """Cameras by which the common time is clearly shorter than what at least half of the cameras
    have, and how many frames of the others are left out.

    Args:
        sources: cameras of the input; of folders alone `numbered_frames_findings` tells.
        timeline: the times of all their frames.
    """
    clocks = {name: clock for name, clock in timeline.clocks.items() if len(clock)}
    several = sum(len(clock) > 1 for clock in clocks.values())
    if len(clocks) < 2 or not several or not any(source.is_video for source in sources):
        return []
    step = max(float(np.median(np.diff(clock))) for clock in clocks.values() if len(clock) > 1)
    starts = {name: float(clock[0]) for name, clock in clocks.items()}
    ends = {name: float(clock[-1]) for name, clock in clocks.items()}
    half = (len(clocks) - 1) // 2
    # At least half of the cameras have begun by the one, and not ended before the other.
    usual = sorted(starts.values())[half], sorted(ends.values(), reverse=True)[half]
    least = max(_SHARE * (usual[1] - usual[0]), 1.5 * step)
    begin, end = max(starts.values()), min(ends.values())
    late = [name for name, time in starts.items() if time - usual[0] > least]
    early = [name for name, time in ends.items() if usual[1] - time > least]
    if not late and not early:
        return []
    left = []
    for name, clock in clocks.items():
        unused = int(np.sum((clock < begin - step / 2) | (clock > end + step / 2)))
        if unused:
            left.append(f"{unused} of the {len(clock)} of {name}")
    others = "the other" if len(clocks) == 2 else "most others"
    limits = [
        f"{first_of(names, _LISTED)} {verb}{' up to' if len(names) > 1 else 's'} {seconds:.2f} s "
        f"{when}"
        for names, verb, seconds, when in (
            (late, "start", begin - usual[0], f"after {others}"),
            (early, "end", usual[1] - end, f"before {others}"),
        )
        if names
    ]
    text = f"frames that are not used: {first_of(left, _LISTED)}; {' and '.join(limits)}"
    names = [name for name in clocks if name in late or name in early]
    # Without most cameras there is nothing left to use the frames for.
    few = 2 * len(names) < len(clocks) and len(clocks) - len(names) > 1
    remedy = "Start all cameras before, and stop them after, what is to be seen"
    if few:
        it = "it" if len(names) == 1 else "them"
        remedy = f"Without {first_of(names, _LISTED)} they are used: take {it} away"
    remedy += "; or give sync.offsets=[...] if the offsets are wrong."
    return [Finding("warn", "sync", text, remedy)]
