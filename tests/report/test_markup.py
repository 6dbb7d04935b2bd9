"""Text stays text in a page, whoever wrote it."""

import re

import numpy as np
import pytest

from gaussray.report.chart import Curve, chart, ticks
from gaussray.report.markup import Markup, concatenate_markup, tag
from gaussray.report.page import Section, html_page, html_table


EVIL = """<script>alert("1")</script>'&"""


def test_children_and_values_are_escaped_and_markup_is_not():
    made = tag("p", EVIL, tag("b", "x"), title=EVIL)
    assert "<script" not in made and made.count("<b>x</b>") == 1
    assert "&lt;script&gt;" in made and "&quot;" in made and "&#x27;&amp;" in made
    assert concatenate_markup([Markup("<i>"), ["<i>", None]]) == "<i>&lt;i&gt;"


def test_attributes_are_named_as_in_html():
    made = tag("path", class_="a", stroke_width=2, hidden=True, title=None, disabled=False)
    assert made == '<path class="a" stroke-width="2" hidden=""></path>'
    assert tag("img", src="x") == '<img src="x">'


def test_a_page_of_untrusted_names_holds_no_element_of_theirs():
    curves = [Curve(EVIL, np.arange(3.0), np.arange(3.0)), Curve("b", np.arange(2.0), np.ones(2))]
    body = [html_table([EVIL, "x"], [[EVIL, 1.0]]), chart(EVIL, curves, x_label=EVIL)]
    made = html_page(EVIL, EVIL, [Section(EVIL, body), None])
    assert made.count("<script>") == 1 and "alert(" in made
    assert "<script>alert" not in made


def test_a_page_asks_for_nothing_from_elsewhere():
    made = html_page("title", "", [Section("part", [tag("p", "text")])])
    assert "default-src 'none'" in made and "prefers-color-scheme: dark" in made
    assert not re.search(r"(src|href)=.(https?:|//)|@import|url\(", made)


@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (23.4, 29.9), (-3e-5, 2e-5), (0.0, 80000.0)])
def test_ticks_are_few_round_numbers_within_the_span(low, high):
    found = ticks(low, high)
    step = np.diff(found)
    assert 2 <= len(found) <= 7 and low - 1e-9 <= found[0] and found[-1] <= high * (1 + 1e-9)
    np.testing.assert_allclose(step, step[0], rtol=1e-6)
    mantissa = step[0] / 10 ** np.floor(np.log10(step[0]) + 1e-9)
    assert min(abs(mantissa - m) for m in (1, 2, 5)) < 1e-6


def test_a_curve_is_drawn_where_its_numbers_say():
    made = chart("t", [Curve("a", np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 0.0]))])
    path = re.search(r'<path d="M([^"]*)" class="curve"', made)
    points = np.array([x.split() for x in path[1].split("L")], float)
    assert points[1, 1] < points[0, 1] == points[2, 1]
    np.testing.assert_allclose(np.diff(points[:, 0]), np.diff(points[:, 0])[0], atol=0.11)


def test_what_is_not_finite_is_not_drawn():
    assert chart("t", [Curve("a", np.arange(2.0), np.array([np.nan, np.inf]))]) == ""
    made = chart("t", [Curve("a", np.arange(3.0), np.array([0.0, 1.0, 10.0]))], log=True)
    assert "nan" not in made and "inf" not in made
