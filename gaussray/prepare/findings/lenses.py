"""Whether the lenses are plausible: each by itself, and beside those of like cameras."""

import re

from gaussray.prepare.findings.finding import Finding
from gaussray.prepare.findings.lens_advice import lens_advice
from gaussray.prepare.lens_check import is_unreadable, lens_complaint
from gaussray.prepare.lens_models import lens_fov
from gaussray.prepare.placed_cameras import camera_lenses
from gaussray.prepare.placement import Placement
from gaussray.runtime.output import listed_names


# Focal lengths of cameras whose pictures have one size may differ by this share.
_FOCALS = 0.15
# A share of the picture in a complaint: cameras that differ in it alone are told of together.
_SHARE = re.compile(r"about (\d+) %")


def lens_findings(placement: Placement) -> list[Finding]:
    """Lenses that no camera has; focal lengths that differ between like cameras."""
    findings, focals, complaints = [], {}, {}
    lenses = camera_lenses(placement)
    by_lens = placement.model.focal_source == "lens"
    given = placement.known or by_lens
    rough = "give the rough field of view in degrees, poses.fov=70"
    if placement.fov_given:
        rough = lens_advice(placement)
    for name, lens in lenses.items():
        focals.setdefault((lens["w"], lens["h"]), {})[name] = lens["fl_x"]
        level, reason = lens_complaint(lens)
        same = complaints.setdefault((level, _SHARE.sub("about # %", reason)), {})
        same[name] = reason
    for (level, _), reasons in complaints.items():
        names, reason = list(reasons), _with_range(list(reasons.values()))
        listed = listed_names(names, list(lenses))
        if level and given:
            unread = any(is_unreadable(lenses[name]) for name in names)
            what = "poses.lens" if by_lens else "the calibration"
            findings.append(_calibrated_lens(f"{listed}: {what} has {reason}", unread))
        elif level:
            findings.append(
                Finding(
                    level,
                    "lens",
                    f"{listed}: estimated {reason}",
                    "Estimate less: poses.intrinsics=shared poses.model=pinhole; "
                    f"{rough}; or give a calibration.",
                )
            )
    for same in focals.values():
        spread = max(same.values()) / min(same.values()) - 1
        if spread > _FOCALS and not given:
            low, high = min(same, key=same.get), max(same, key=same.get)
            text = (
                f"the focal lengths of {low} ({same[low]:.4g} pixels) and {high} "
                f"({same[high]:.4g}) differ although their pictures have one size"
            )
            remedy = "If the cameras are alike, poses.intrinsics=shared."
            findings.append(Finding("warn", "lens", text, remedy))
    fovs = [round(lens_fov(lens)) for lens in lenses.values()]
    across = f"{min(fovs)}" if min(fovs) == max(fovs) else f"{min(fovs)} to {max(fovs)}"
    if placement.model.focal_source == "guess":
        text = (
            "the pictures do not tell the focal length: one 20 % shorter or longer explains them "
            f"as well; {across} degrees across the width are a guess"
        )
        findings.append(Finding("warn", "lens", text, f"Better: {lens_advice(placement)}."))
    if not findings:
        text = f"horizontal fields of view of {across} degrees"
        if placement.model.focal_source == "expected":
            text += ", as expected: the pictures do not tell"
        if by_lens:
            text += ", as poses.lens says"
        findings.append(Finding("good", "lens", text))
    return findings


def _with_range(reasons: list[str]) -> str:
    """Complaints that differ in a share alone as one, with the least and the largest."""
    found = sorted(int(match[1]) for reason in reasons if (match := _SHARE.search(reason)))
    if not found or found[0] == found[-1]:
        return reasons[0]
    return _SHARE.sub(f"about {found[0]} to {found[-1]} %", reasons[0])


def _calibrated_lens(text: str, unread: bool) -> Finding:
    """The finding about an unusual lens that was calibrated, refused only if readers refuse it."""
    remedy = "Check that the file is of this camera, zoom and picture size."
    if "turns back within" in text:
        remedy += " Calibrate again with the board at the edges, too"
        remedy += ", or take the video away." if unread else "; these pixels do not count."
    return Finding("refuse" if unread else "warn", "lens", text, remedy)
