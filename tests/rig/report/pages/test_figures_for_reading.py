"""Figures as pages show them: minus signs of print, shortened digests, and counts in the singular."""

from rig.formats.numbers_and_units import count_text
from rig.report.pages.html_and_svg_elements import svg_text, table_html, text_with_typographic_minus_signs

DIGEST = "0123456789abcdef" * 4


def test_numbers_of_a_table_have_the_minus_sign_of_print():
    made = table_html(("axis", "change"), [("strut-1", "-0.71"), ("strut 2", "0.5 ± -2"), ("3", "1e-06 (-3 to 2)")])
    assert all(shown in made for shown in (">−0.71<", "± −2", "1e−06 (−3 to 2)", "strut-1"))
    assert text_with_typographic_minus_signs("2026-11-23 a-1") == "2026-11-23 a-1"
    assert ">−5<" in svg_text(0, 0, "-5") and "--seed -1" in svg_text(0, 0, "--seed -1")


def test_words_that_may_be_copied_stay():
    assert "rig jog --by -0.5mm" in table_html(("what", "value"), [("arguments", "rig jog --by -0.5mm"), ("b", "c")])


def test_a_digest_is_shown_by_its_first_digits_and_whole_in_its_title():
    made = table_html(("what", "value"), [("inputs_sha256 / REC / frames.csv", DIGEST), ("created", "2026-11-23")])
    assert f'title="SHA-256 {DIGEST}">{DIGEST[:12]}</code>' in made and made.count(DIGEST) == 1


def test_one_is_counted_in_the_singular():
    assert count_text(1, "frame has no pose", "frames have no pose") == "1 frame has no pose"
    assert count_text(2, "configuration") == "2 configurations"
