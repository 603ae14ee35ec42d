"""Every measured figure in the documents comes from a kept result, and says the same."""

import re
from pathlib import Path

import pytest

from docs.make import results
from tests.docs.told import ROOT

PAGES = [path for path in (*sorted((ROOT / "docs").rglob("*.md")), ROOT / "README.md", ROOT / "CHANGELOG.md")
         if path != results.PAGE and path.name not in ("rig-toml.md", "tables.md", "effects.md")]
LINK = re.compile(r"\[([^\]]+)\]\((?:\.\./|docs/)*results\.md#([\w-]+)\)")
GENERAL = {"results", "figures"}  # words of links that state no figure
MEASURED = (r"\b\d+ of (?!255\b)(?:the |a )?\d+\b", r"\b[\d.]+ (?:and [\d.]+ )?times as (?:fast|quick|long)", r"\bmillionth\b",
            r"\bcampaign of \d+", r"\bmedians? of\b", r"\b[\d.]+ (?:s|min|ms) of one core", r"\bfalse alarms? in \d", r"\bof processor time\b",
            r"\| [\d.]+ %? ?\|")


def prose(path: Path) -> str:
    """A page without blocks of code, tables' code and links to results, whose words are held to the files by another test."""
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("    ")]
    return re.sub(r"`[^`]*`", "", LINK.sub("", "\n".join(lines)))


def test_the_page_is_current():
    assert results.PAGE.read_text(encoding="utf-8") == results.page(), "python -m tests.bench.results NAME .. measures anew and writes it"


@pytest.mark.parametrize("record", results.kept(), ids=lambda record: record["name"])
def test_a_kept_result_says_where_it_came_from(record):
    assert re.fullmatch(r"[0-9a-f]{12}", record["commit"]), "measured on a tree that no commit holds"
    assert record["command"].startswith(("python -m tests.bench", "rig ")) and record["created"] and record["machine"]["cores"] and "seed" in record
    assert record["figures"] and all({"figure", "reached", "wanted"} <= set(row) for row in record["figures"])


@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_figures_that_link_to_results_say_what_they_say(path):
    reached = {record["name"]: " | ".join(row["reached"] for row in record["figures"]) for record in results.kept()}
    wrong = [(words, name) for words, name in LINK.findall(path.read_text(encoding="utf-8"))
             if name not in reached or words not in GENERAL and words not in reached[name]]
    assert wrong == []


@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_no_measured_figure_stands_without_its_result(path):
    text = prose(path)
    assert [match.group() for pattern in MEASURED for match in re.finditer(pattern, text)] == []
