"""The pieces of the page: what is text stays text, and a table has as many cells as its head."""

from __future__ import annotations

import pytest

from metafab.report import html


@pytest.mark.parametrize(
    ("key", "head"),
    [
        ("depth_error_m", "depth error / m"),
        ("centre_um", "centre / µm"),
        ("phase_rms_error_rad", "phase rms error / rad"),
        ("m", "m"),
        ("slope_x_per_m", "slope x / m⁻¹"),
        ("kept_per", "kept per"),
        ("segment", "segment"),
        ("rotation_deg", "rotation / °"),
        ("a<b_m", "a&lt;b / m"),
    ],
)
def test_a_key_becomes_words_and_a_unit(key: str, head: str) -> None:
    assert html.column(key) == head


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("run `metafab run`", "run <code>metafab run</code>"),
        ("`a` and `<b>`", "<code>a</code> and <code>&lt;b&gt;</code>"),
        ("a ` alone", "a ` alone"),
        (3.5, "3.5"),
    ],
)
def test_backticks_are_code_and_nothing_is_markup(text: object, shown: str) -> None:
    assert html.prose(text) == shown
    assert html.note(str(text)) == f'<p class="note">{shown}.</p>'


def test_a_question_has_no_full_stop() -> None:
    assert html.note("is it?") == '<p class="note">is it?</p>'


def test_a_table_keeps_the_class_of_each_column() -> None:
    text = html.table(["rule", "violations"], [["gap", "0"], ["grid", "2"]], ["", "n"], "stack")
    assert text.count("<tr>") == 3
    assert text.count('<td class="n">') == 2
    assert '<th class="n">violations</th>' in text
    assert '<table class="stack">' in text


@pytest.mark.parametrize("row", [["one"], ["one", "two", "three"]])
def test_a_row_of_another_length_is_a_fault_of_ours(row: list[str]) -> None:
    with pytest.raises(ValueError, match="zip"):
        html.table(["rule", "violations"], [row])


def test_empty_pieces_leave_no_trace() -> None:
    assert html.section("s", "A & B", "", "<p>x</p>", "") == (
        '<section id="s">\n<h2>A &amp; B</h2>\n<p>x</p>\n</section>'
    )
    assert html.figure("<svg/>") == "<figure><svg/></figure>"
    assert "<figcaption>c</figcaption>" in html.figure("<svg/>", "c")


@pytest.mark.parametrize("tone", ["", "good", "bad"])
def test_a_headline_is_a_figure_with_what_it_means(tone: str) -> None:
    assert html.headline("0", "rules broken", tone) == f'<li class="{tone}"><b>0</b><span>rules broken</span></li>'


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "–"),
        (True, "yes"),
        (25600000, "25\u202f600\u202f000"),
        (4501.0, "4\u202f501"),
        (0.0017, "0.0017"),
        (-160.04, "−160"),
        (5.307e-6, "5.31\u202f×\u202f10<sup>−6</sup>"),
        (2.5e12, "2\u202f500\u202f000\u202f000\u202f000"),
        ("<b>", "&lt;b&gt;"),
    ],
)
def test_numbers_are_for_reading(value: object, text: str) -> None:
    assert html.number(value) == text
