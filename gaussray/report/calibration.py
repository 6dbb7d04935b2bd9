"""What a calibration found: numbers of the cameras before and after, and how sure they are."""

from typing import Any

from gaussray.report.markup import tag
from gaussray.report.page import Section, note, table, tiles


def figures(report: dict[str, Any]) -> Section:
    """How well the pictures are explained, before and after."""
    before, after = report["psnr"]["before"], report["psnr"]["after"]
    told = [
        ("before", f"{before:.2f}", "dB"),
        ("after", f"{after:.2f}", "dB"),
        ("pictures", str(report["pictures"]), report["effect"].replace("_", " ")),
        ("cameras", str(len(report["cameras"])), ""),
    ]
    return Section("Summary", [tiles(told)])


def parameters(report: dict[str, Any]) -> Section:
    """Every number: as recorded, as found, and its standard errors."""
    rows = [
        (
            " ".join(filter(None, (one.get("camera"), one["name"]))),
            one["unit"],
            f"{one['start']:.6g}",
            f"{one['value']:.6g}",
            f"{one['standard_error']['independent']:.2g}",
            f"{one['standard_error']['tiles']:.2g}",
        )
        for one in report["parameters"]
    ]
    heads = "number", "unit", "recorded", "found", "error", "error, tiles"
    words = (
        "Standard errors: if errors of pixels were drawn again, each by itself, or alike within "
        "tiles of 8 x 8 pixels. What the scene has wrong everywhere shifts values beyond both."
    )
    told = [tag("p", line) for line in report["confounded"]]
    return Section("What was found", [table(heads, rows, text=2), *told, note(words)])


def levels(report: dict[str, Any]) -> Section | None:
    """What was left at every size of the pictures, coarse ones first."""
    told = report["levels"]
    if not told:
        return None
    rows = [(f"1/{one['pixels']}", str(one["steps"]), f"{one['deviation']:.3f}") for one in told]
    heads = "size of the pictures", "steps", "deviation"
    words = "Deviation of the encoded pictures, in codes of 255."
    return Section("From coarse to fine", [table(heads, rows), note(words)])
