"""Whether the cameras show one thing equally bright."""

from collections.abc import Mapping

import numpy as np

from gaussray.prepare.exposure import LEAST_SHARED
from gaussray.prepare.findings.finding import Finding
from gaussray.runtime.output import first_of


# Stops by which exposures may differ.
STOPS = 0.15
# Share of a picture, beyond that of the other cameras, that is clipped where it is too bright: a
# guess, far above what lamps and windows make.
_CLIPPED = 0.25
# Names that are listed, at most.
_LISTED = 8
# Stops by which the channels of pictures without colour differ at most.
_GREY = 0.005
_CHANNELS = ("red", "green", "blue")
_LOCK = "fit.refine=[exposure]; better: lock exposure and white balance when recording."
_LOCK_ALONE = "Lock exposure and white balance when recording; a fit has one gain for each camera."


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


def picture_exposure_findings(
    gains: Mapping[str, np.ndarray], *, photographs: bool
) -> list[Finding]:
    """Differences of brightness between the pictures of a camera on its way: an exposure or a white
    balance that it chooses for each.

    Args:
        gains: gain of each picture, NaN where it is unknown (`picture_gains`).
        photographs: whether each picture is a camera of its own in the capture, as photographs are:
            the fit has a gain for each camera.
    """
    known = {name: gain for name, gain in gains.items() if np.isfinite(gain).all()}
    if len(known) < 2:
        return []
    stops, names = np.stack(list(known.values())), list(known)
    worst = int(np.abs(stops).max(axis=0).argmax())
    size = float(np.abs(stops[:, worst]).max())
    # The channels of grey pictures are equal.
    grey = float(np.ptp(stops, axis=1).max()) < _GREY
    channel = "" if grey else f" of {_CHANNELS[worst]}"
    left = len(gains) - len(known)
    but = f"; {left} of {len(gains)} share too few points to be compared" if left else ""
    if size <= STOPS:
        text = f"pictures agree with the mean of their camera to {size:.2f} stops{but}"
        return [Finding("good", "exposure", text)]
    darkest, brightest = names[stops[:, worst].argmin()], names[stops[:, worst].argmax()]
    text = (
        f"pictures of a camera differ from their mean by up to {size:.2f} stops{channel} "
        f"({darkest} is the darkest, {brightest} the brightest){but}"
    )
    return [Finding("warn", "exposure", text, _LOCK if photographs else _LOCK_ALONE)]


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
