"""The table of scores on the page of an evaluation."""

from gaussray.report.evaluation import score_table
from gaussray.report.page import Section


def table(remarks=(), **row):
    report = {"effects": {"pinhole": {"psnr": 20.0, "samples": 1, **row}}, "remarks": list(remarks)}
    section = score_table(report)
    assert isinstance(section, Section)
    return "".join(map(str, section.body))


def test_columns_are_those_that_were_measured():
    usual = table()
    assert "<th>exposure-matched PSNR</th>" not in usual and "opacity outside masks" not in usual
    shown = table(psnr_matched=23.456, opacity_outside_masks=0.1234)
    assert "exposure-matched PSNR" in shown and "23.46" in shown
    assert "opacity outside masks" in shown and "0.123" in shown


def test_remarks_stand_below_the_table():
    page = table(remarks=["Masks decide what counts.", "Fog outside the masks."])
    assert page.index("</table>") < page.index("Masks decide") < page.index("Fog outside")
