"""Whether the lenses are plausible: each by itself, and beside those of like cameras."""

from gaussray.prepare.findings.finding import Finding
from gaussray.prepare.lens_check import is_unreadable, lens_complaint
from gaussray.prepare.lens_models import lens_fov
from gaussray.prepare.placed_cameras import camera_lenses
from gaussray.prepare.poses import Placement


# Focal lengths of cameras whose pictures have one size may differ by this share.
_FOCALS = 0.15


def lens_findings(placement: Placement) -> list[Finding]:
    """Lenses that no camera has; focal lengths that differ between like cameras."""
    findings, focals, complaints = [], {}, {}
    lenses = camera_lenses(placement)
    by_lens = placement.model.focal_source == "lens"
    given = placement.known or by_lens
    for name, lens in lenses.items():
        focals.setdefault((lens["w"], lens["h"]), {})[name] = lens["fl_x"]
        complaints.setdefault(lens_complaint(lens), []).append(name)
    for (level, reason), names in complaints.items():
        listed = ", ".join(names[:8]) + ("..." if len(names) > 8 else "")
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
                    "Estimate less: poses.intrinsics=shared poses.model=pinhole; give the rough "
                    "field of view in degrees, poses.fov=70; or give a calibration.",
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
        remedy = "If you know the lens, poses.lens=FILE or poses.fov=DEGREES."
        findings.append(Finding("warn", "lens", text, remedy))
    if not findings:
        text = f"horizontal fields of view of {across} degrees"
        if placement.model.focal_source == "expected":
            text += ", as expected: the pictures do not tell"
        if by_lens:
            text += ", as poses.lens says"
        findings.append(Finding("good", "lens", text))
    return findings


def _calibrated_lens(text: str, unread: bool) -> Finding:
    """The finding about an unusual lens that was calibrated, refused only if readers refuse it."""
    remedy = "Check that the file is of this camera, zoom and picture size."
    if "turns back within" in text:
        remedy += " Calibrate again with the board at the edges, too"
        remedy += ", or take the video away." if unread else "; these pixels do not count."
    return Finding("refuse" if unread else "warn", "lens", text, remedy)
