"""The page of validation is made from the kept results, and states the source of every published figure."""

import re

import pytest

from docs.make import results, validation


def test_the_page_is_current():
    assert validation.PAGE.read_text(encoding="utf-8") == validation.page(), (
        "python -m docs.make.validation > docs/validation.md"
    )


def test_every_table_names_its_command_and_every_published_figure_its_source():
    page = validation.page()
    tables = len(validation.QUESTIONS) + len(validation.PEERS)
    assert len(re.findall(r"^`(?:python -m tests.bench|rig) .*results.md#", page, re.MULTILINE)) == tables
    assert all(re.search(r"\]\(https?://\S+\)$", source) for *_, source in validation.SOURCES)


def test_a_figure_that_is_gone_is_named(monkeypatch):
    monkeypatch.setattr(validation, "QUESTIONS", (("Q?", "way", ("no such figure",)),))
    with pytest.raises(ValueError, match="Q\\?: no figure of way.json contains 'no such figure'"):
        validation.page()
    monkeypatch.setattr(results, "newest", lambda: [])
    with pytest.raises(ValueError, match="make results BENCH=way"):
        validation.page()
