"""The documents are written in short sentences and plain words, measured; how that is measured is held to counts made
by hand.
"""

import pytest

from tests.docs import readability
from tests.docs.readability import blocks, measure, page_sentences, sentences, syllables

EASE, LONG = 50, 0.08  # least reading ease; greatest share of sentences over readability.LONGEST words
BY_HAND = {
    "pose": 1, "struts": 1, "named": 1, "noted": 2, "edges": 2, "axes": 2, "table": 2, "able": 2, "calibrate": 3,
    "calibration": 4, "corrected": 3, "residual": 4, "covariance": 4, "requirement": 3,
    "0.25": 1, "m": 1, "video": 3, "trying": 2, "statement": 2, "machine": 2,
}  # fmt: skip


def test_syllables_are_those_counted_by_hand():
    assert {word: syllables(word) for word in BY_HAND} == BY_HAND


def test_reading_ease_is_that_of_the_formula():
    found = [["The", "platform", "moves"], ["It", "stops"]]  # 5 words, 2 sentences, 6 syllables
    assert measure(found).ease == pytest.approx(206.835 - 1.015 * 5 / 2 - 84.6 * 6 / 5)
    assert (measure([["word"] * 26, ["word"] * 25]).long, measure([["word"] * 26, ["word"] * 25]).sentences) == (1, 2)
    with pytest.raises(ValueError, match="no sentence"):
        measure([])


def test_code_headings_and_tables_are_no_prose():
    text = "# Head\n\nOne `rig run REC` line\ngoes on. **Two** is here.\n\n    rig run\n\n"
    text += "| a | b |\n|---|---|\n| c d | e |\n"
    text += "\n- first item\n  goes on\n- second\n\n```python\nx = 1\n```\n$$ x \\tag{1} $$\n"
    text += "**Lead.** At 1.5 mm, e.g. here. $x$ ends ..\n"
    assert blocks(text) == [
        "One `rig run REC` line goes on. **Two** is here.", "first item goes on", "second",
        "**Lead.** At 1.5 mm, e.g. here. $x$ ends ..",
    ]  # fmt: skip
    assert blocks(text, tables=True) == ["a", "b", "c d", "e"]
    assert sentences("**Lead.** At 1.5 mm, e.g. here. $x$ ends .. [The page](a.md).") == [
        ["At", "1.5", "mm,", "eg", "here."],
        ["Value", "ends", "The", "page."],
    ]


def test_documents_are_read_with_ease_and_few_sentences_are_long():
    measures = [measure(page_sentences(path)) for path in readability.WRITTEN]
    assert sum(one.ease for one in measures) / len(measures) >= EASE
    assert sum(one.long for one in measures) <= LONG * sum(one.sentences for one in measures)


@pytest.mark.parametrize("path", readability.WRITTEN, ids=lambda path: path.name)
def test_no_page_is_much_harder_than_the_others(path):
    one = measure(page_sentences(path))
    assert one.ease >= EASE and one.long <= max(1, LONG * one.sentences), "python -m tests.docs.readability"


def test_every_written_page_has_sentences():
    assert len(readability.WRITTEN) > 25 and all(page_sentences(path) for path in readability.WRITTEN)
