"""The glossary is short and in order, and each page's first use of a special word links to it."""

import re

import pytest

from docs.make import glossary_links
from tests.docs.document_commands import ROOT

ROWS = glossary_links.ROWS
LONGEST = 25  # words


def test_words_are_in_order_each_with_its_anchor():
    words = [word for _, word, _ in ROWS]
    assert len(words) > 40 and words == sorted(words, key=str.lower)
    assert [anchor for anchor, _, _ in ROWS] == [re.sub(r"[^a-z0-9]+", "-", word.lower()) for word in words]
    lines = [line for line in glossary_links.PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| ")]
    assert len(lines) == len(words) + 1


def test_meanings_are_short():
    assert [word for _, word, meaning in ROWS if len(meaning.split()) > LONGEST] == []


def test_every_word_is_linked_somewhere_if_it_occurs():
    linked = {anchor for page in glossary_links.pages() for anchor in glossary_links.links(page.read_text("utf-8"))}
    assert len(linked) > 40 and linked <= set(glossary_links.SPECIAL)
    assert set(glossary_links.FORMS) <= set(glossary_links.SPECIAL)


@pytest.mark.parametrize("page", glossary_links.pages(), ids=lambda path: str(path.relative_to(ROOT)))
def test_the_first_use_of_a_special_word_links_to_its_line(page):
    text = page.read_text(encoding="utf-8")
    assert text == glossary_links.linked(text, glossary_links.path_of(page)), "python -m docs.make.glossary_links"
    special = [anchor for anchor in glossary_links.links(text) if anchor in glossary_links.SPECIAL]
    assert sorted(special) == sorted(set(special)), "one link a word"


def test_links_are_laid_in_prose_alone_and_once():
    text = "# Claims\n\n    rig claim\n\nA `claim` of [claims](x.md), $claim$; two {},\na claim.\n"
    made = glossary_links.linked(text.format("Claims"), "glossary.md")
    assert made == text.format("[Claims](glossary.md#claim)") == glossary_links.linked(made, "glossary.md")
