"""Whether the clocks of the cameras agree, and which pictures are not used."""

from collections.abc import Sequence

from gaussray.prepare.findings.common_time import common_time_findings
from gaussray.prepare.findings.finding import Finding
from gaussray.prepare.findings.numbered_frames import numbered_frames_findings
from gaussray.prepare.sources import Source
from gaussray.prepare.sync import Sync
from gaussray.prepare.timeline import Timeline, of_one_rate, resampled


def sync_findings(sources: Sequence[Source], sync: Sync, timeline: Timeline) -> list[Finding]:
    """Confidence of the offsets, rates that differ, and pictures that are not used.

    Args:
        sources: cameras of the input.
        sync: offsets of their clocks, with confidence and disagreement.
        timeline: rate of the timestamps; disagreements above half a frame are reported.
    """
    findings = []
    videos = [source.name for source in sources if source.is_video]
    weak = [name for name in videos if name in sync.assumed]
    if sync.method not in ("none", "known") and len(videos) > 1:
        by = f"by {sync.method}, confidence {min(sync.confidence[n] for n in videos):.2f} or more"
        if not weak:
            findings.append(Finding("good", "sync", f"all videos are synchronised {by}"))
        else:
            findings.append(
                Finding(
                    "warn",
                    "sync",
                    _assumed_text(weak, videos, sync.method),
                    "If they do not, give sync.offsets=[...]; fit.refine=[offset] refines what is "
                    "off by less than a few frames.",
                )
            )
    elif len(videos) > 1:
        text = "the videos start together" if sync.method == "none" else "the offsets are given"
        findings.append(Finding("good", "sync", text))
    off = {n: d for n, d in sync.disagreement.items() if d > 0.5 / max(timeline.rate, 1)}
    if off:
        findings.append(
            Finding(
                "warn",
                "sync",
                f"pairs of cameras disagree by {1000 * max(off.values()):.0f} ms about "
                f"{', '.join(off)}",
                "Look at a fast event in each video; give sync.offsets=[...] if they are off.",
            )
        )
    # Videos of one rate show every frame that they were asked for.
    if not of_one_rate(sources) and (names := resampled(sources, timeline)):
        findings.append(
            Finding(
                "warn",
                "sync",
                f"{', '.join(names)} show their nearest frames at {timeline.rate:.4g} per second; "
                "the remaining shift of each frame is recorded as the delay of its shutter",
                "Record all cameras at one rate to use all their frames.",
            )
        )
    findings += common_time_findings(sources, timeline)
    return findings + numbered_frames_findings(sources, timeline)


def _assumed_text(weak: Sequence[str], videos: Sequence[str], method: str) -> str:
    """Which videos have no trusted offset, and with which one they are taken to start."""
    sure = [name for name in videos if name not in weak]
    if sure:
        return (
            f"{', '.join(weak)}: no trusted synchronisation by {method}; taken to start with "
            f"{sure[0]}"
        )
    return f"no trusted synchronisation by {method}; all videos are taken to start together"
