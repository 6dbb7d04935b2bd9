"""Whether the cameras show one thing equally bright."""

import numpy as np

from gaussray.prepare.exposure import LEAST_SHARED
from gaussray.prepare.findings.finding import Finding
from gaussray.runtime.output import first_of


# Stops by which exposures may differ.
STOPS = 0.15
# Names that are listed, at most.
_LISTED = 8


def exposure_findings(gains: dict[str, tuple[np.ndarray, int]]) -> list[Finding]:
    """Differences of brightness between cameras, and cameras too dark to compare."""
    known = {name: gain for name, (gain, count) in gains.items() if count >= LEAST_SHARED}
    dark = [name for name in gains if name not in known and np.any(gains[name][0] < 0)]
    findings = [_too_dark(name, gains[name][0]) for name in dark]
    if len(known) < 2:
        text = "too few shared points to compare the cameras' exposures"
        remedy = "fit.refine=[exposure] if pictures of one thing differ in brightness."
        return [*findings, Finding("warn", "exposure", text, remedy)] if len(gains) > 1 else []
    left = [name for name in gains if name not in known]
    but = f" ({first_of(left, _LISTED)} not compared)" if left else ""
    worst = max(known, key=lambda name: np.abs(known[name]).max())
    size = float(np.abs(known[worst]).max())
    if size > STOPS:
        text = f"{worst} differs from the mean of all cameras by up to {size:.2f} stops{but}"
        remedy = "fit.refine=[exposure]; better: lock exposure and white balance when recording."
        return [*findings, Finding("warn", "exposure", text, remedy)]
    return [*findings, Finding("good", "exposure", f"cameras agree to {size:.2f} stops{but}")]


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
