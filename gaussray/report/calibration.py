"""Sections of a calibration report: parameters before and after, with standard errors."""

from typing import Any

from gaussray.report.markup import tag
from gaussray.report.page import Section, html_table, note, summary_tiles


def calibration_summary(report: dict[str, Any]) -> Section:
    """PSNR before and after, number of pictures and cameras."""
    before, after = report["psnr"]["before"], report["psnr"]["after"]
    rows = [
        ("PSNR before", f"{before:.2f}", "dB"),
        ("PSNR after", f"{after:.2f}", "dB"),
        ("pictures", str(report["pictures"]), report["effect"].replace("_", " ")),
        ("cameras", str(len(report["cameras"])), ""),
    ]
    return Section("Summary", [summary_tiles(rows)])


def parameter_table(report: dict[str, Any]) -> Section:
    """A row for every estimated parameter: recorded, estimated, standard errors."""
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
    heads = "parameter", "unit", "recorded", "estimated", "standard error", "tile error"
    words = (
        "Standard error: the scatter of a value if errors are independent from pixel to pixel. "
        "Tile error: if errors are equal within tiles of 8 x 8 pixels. Systematic errors of the "
        "scene can shift values beyond both."
    )
    warnings = [tag("p", line) for line in report["confounded"]]
    return Section(
        "Estimated parameters", [html_table(heads, rows, text=2), *warnings, note(words)]
    )


def level_table(report: dict[str, Any]) -> Section | None:
    """Steps and remaining residuals at each level, coarse to fine."""
    levels = report["levels"]
    if not levels:
        return None
    rows = [
        (f"1/{level['pixels']}", str(level["steps"]), f"{level['deviation']:.3f}")
        for level in levels
    ]
    heads = "picture size", "steps", "residual"
    words = "Residual: standard deviation of rendered minus recorded sRGB values, in 8-bit levels."
    return Section("From coarse to fine", [html_table(heads, rows), note(words)])
