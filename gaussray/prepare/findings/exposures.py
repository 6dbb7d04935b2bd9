"""Whether the cameras show one thing equally bright."""

import numpy as np

from gaussray.prepare.exposure import LEAST_SHARED
from gaussray.prepare.findings.finding import Finding


# Stops by which exposures may differ.
STOPS = 0.15


def exposure_findings(gains: dict[str, tuple[np.ndarray, int]]) -> list[Finding]:
    """Differences of brightness between cameras."""
    known = {name: gain for name, (gain, count) in gains.items() if count >= LEAST_SHARED}
    if len(known) < 2:
        text = "too few shared points to compare the cameras' exposures"
        remedy = "fit.refine=[exposure] if pictures of one thing differ in brightness."
        return [Finding("warn", "exposure", text, remedy)] if len(gains) > 1 else []
    worst = max(known, key=lambda name: np.abs(known[name]).max())
    size = float(np.abs(known[worst]).max())
    if size > STOPS:
        text = f"{worst} differs from the mean of all cameras by up to {size:.2f} stops"
        remedy = "fit.refine=[exposure]; better: lock exposure and white balance when recording."
        return [Finding("warn", "exposure", text, remedy)]
    return [Finding("good", "exposure", f"cameras agree to {size:.2f} stops")]
