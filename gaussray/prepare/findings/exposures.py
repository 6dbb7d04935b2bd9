"""Whether the cameras show one thing equally bright."""

from collections.abc import Mapping

import numpy as np

from gaussray.prepare.exposure import LEAST_SHARED
from gaussray.prepare.findings.finding import Finding
from gaussray.runtime.output import first_of


# Stops by which exposures may differ.
STOPS = 0.15
# Share of a picture, beyond that of the other cameras, that is clipped where it is too bright.
_CLIPPED = 0.25
# Names that are listed, at most.
_LISTED = 8
_LOCK = "fit.refine=[exposure]; better: lock exposure and white balance when recording."


def exposure_findings(
    gains: dict[str, tuple[np.ndarray, int]], clipped: Mapping[str, float]
) -> list[Finding]:
    """Differences of brightness between cameras, and cameras too dark or too bright to compare.

    Args:
        gains: gain of each camera and number of its observations (`exposure_gains`).
        clipped: for each camera the share of its picture that is clipped (`observed_levels`).
    """
    known = {name: gain for name, (gain, count) in gains.items() if count >= LEAST_SHARED}
    dark = [name for name in gains if name not in known and np.any(gains[name][0] < 0)]
    findings = [_too_dark(name, gains[name][0]) for name in dark]
    # A white wall is as white in the others; without these, nobody knows.
    usual = float(np.median([clipped[name] for name in known])) if known else 1.0
    findings += [
        _too_bright(name, clipped[name])
        for name in gains
        if name not in known and clipped[name] - usual > _CLIPPED
    ]
    if len(known) < 2:
        text = "too few shared points to compare the cameras' exposures"
        remedy = "fit.refine=[exposure] if pictures of one thing differ in brightness."
        return [*findings, Finding("warn", "exposure", text, remedy)] if len(gains) > 1 else []
    left = [name for name in gains if name not in known]
    why = f"fewer than {LEAST_SHARED} shared points that are neither black nor clipped"
    but = f" ({first_of(left, _LISTED)} not compared: {why})" if left else ""
    worst = max(known, key=lambda name: np.abs(known[name]).max())
    size = float(np.abs(known[worst]).max())
    if size > STOPS:
        text = f"{worst} differs from the mean of all cameras by up to {size:.2f} stops{but}"
        return [*findings, Finding("warn", "exposure", text, _LOCK)]
    return [*findings, Finding("good", "exposure", f"cameras agree to {size:.2f} stops{but}")]


def picture_exposure_findings(gains: Mapping[str, np.ndarray]) -> list[Finding]:
    """Differences of brightness between the pictures of cameras on their way: an exposure or a
    white balance that a camera chooses for each.

    Args:
        gains: gain of each picture (`picture_gains`).
    """
    if len(gains) < 2:
        return []
    stops = np.stack(list(gains.values()))
    size = float(np.abs(stops).max())
    if size <= STOPS:
        return [Finding("good", "exposure", f"pictures agree to {size:.2f} stops")]
    light = dict(zip(gains, stops.mean(axis=1).tolist(), strict=True))
    darkest, brightest = min(light, key=light.__getitem__), max(light, key=light.__getitem__)
    text = (
        f"pictures show the same points up to {np.ptp(stops, axis=0).max():.2f} stops apart in a "
        f"channel ({darkest} is the darkest, {brightest} the brightest)"
    )
    return [Finding("warn", "exposure", text, _LOCK)]


def _too_bright(name: str, share: float) -> Finding:
    """The finding about a camera of whose picture so large a share is clipped."""
    text = (
        f"{name} has too few shared points to compare, and {100 * share:.0f} % of its picture is "
        "clipped, far more than of the others"
    )
    remedy = (
        "If it is exposed for longer than the others, close its aperture or expose shorter; "
        "nothing brings back what is clipped."
    )
    return Finding("warn", "exposure", text, remedy)


def _too_dark(name: str, gain: np.ndarray) -> Finding:
    """The finding about a camera that shows so little light that it shares hardly a point."""
    text = (
        f"{name} is too dark to compare: its pictures are about {-gain.min():.0f} stops darker "
        "than those of the other cameras"
    )
    remedy = (
        "Open its aperture or expose longer, or take its video away; fit.refine=[exposure] makes "
        "up for a few stops, but not for details lost in the dark."
    )
    return Finding("warn", "exposure", text, remedy)
