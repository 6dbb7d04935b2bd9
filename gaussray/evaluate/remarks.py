"""What the scores of an evaluation do not say by themselves, a sentence each."""

from collections.abc import Mapping
from typing import Any

from gaussray.evaluate.found_cameras import FoundCapture


# Remarks begin above this mean opacity, and above so many dB that exposures explain.
_OPACITY, _GAIN = 0.1, 0.5


def remarks(report: Mapping[str, Any], parts: set[str], found: FoundCapture) -> list[str]:
    """Sentences about masks, fog outside them, exposures, and views that were not held out.

    Args:
        report: the report, with the scores of its effects.
        parts: the parts that the scored pictures belong to (`FoundCapture.part`).
        found: the capture, and what the fit found for it.
    """
    sentences: list[str] = []
    several = len(report["effects"]) > 1
    for effect, row in report["effects"].items():
        own = [_masks(row), _opacity(row), _exposures(row, bool(found.responses))]
        sentences += [f"{effect}: {text}" if several else text for text in own if text]
    return sentences + ([] if "held_out_cameras" in parts else [_no_other_camera(found)])


def _masks(row: Mapping[str, Any]) -> str:
    share = row.get("shown_share", 1.0)
    if share > 0.995:
        return ""
    return (
        f"Masks decide what counts: scores are means over the {100 * share:.0f} % of the pixels "
        "that they show."
    )


def _opacity(row: Mapping[str, Any]) -> str:
    opacity = row.get("opacity_outside_masks", 0.0)
    if opacity <= _OPACITY:
        return ""
    return (
        f"Fog outside the masks: the rendering has a mean opacity of {opacity:.2f} where masks "
        "hide the pictures, which PSNR does not count. A larger loss.outside_opacity of the "
        "reconstruction removes more of it."
    )


def _exposures(row: Mapping[str, Any], refined: bool) -> str:
    psnr, matched = row.get("psnr"), row.get("psnr_matched")
    if psnr is None or matched is None or matched - psnr <= _GAIN:
        return ""
    remedy = (
        "The fit learnt the exposures of its own pictures only: exposure-matched PSNR compares "
        "others."
        if refined
        else "fit.refine=[exposure] of the reconstruction learns that of each training camera."
    )
    return (
        f"Exposures explain {matched - psnr:.1f} dB of the error: those of pictures and renderings "
        f"differ by {row['exposure_stops']:.1f} stops (rms). {remedy}"
    )


def _no_other_camera(found: FoundCapture) -> str:
    sentence = "Only pictures of fitted cameras were scored, none of a held-out camera."
    views = found.capture.all_views
    if any(found.part(view) == "held_out_cameras" for view in views):
        return f"{sentence} evaluate.split=all scores those, too."
    if len({view.camera_name for view in views}) > 1:
        return f"{sentence} capture.test=[CAMERA] of the reconstruction holds one out."
    return sentence
