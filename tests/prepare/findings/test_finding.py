"""Findings of several cameras are one, and what is doubtful is told with its remedy."""

from gaussray.prepare.findings.finding import Finding, doubts_text, merged_findings


def scaled(name, size="8 x 6", level="warn"):
    return Finding(level, "lens", f"{name}: the calibration is of {size}; it is scaled", "Check.")


def test_what_is_said_of_several_cameras_is_said_once():
    other = Finding("good", "sync", "all videos are synchronised")
    found = merged_findings([scaled("a"), other, scaled("b"), scaled("c", "9 x 6"), scaled("d")])
    assert found == [scaled("a, b, d"), other, scaled("c", "9 x 6")]
    many = merged_findings([scaled(f"cam{k}") for k in range(9)])
    assert many == [scaled(", ".join(f"cam{k}" for k in range(8)) + " ...")]


def test_remedies_are_told_with_what_is_doubtful():
    good = Finding("good", "points", "90 points")
    assert doubts_text([good]) == doubts_text([]) == ""
    assert doubts_text(
        merged_findings([scaled("a"), good, scaled("b"), Finding("warn", "sync", "off")])
    ) == (
        "2 doubtful:\n- lens: a, b: the calibration is of 8 x 6; it is scaled. Check.\n- sync: off."
    )
