"""Every measured figure in the documents comes from a kept result, and says the same."""

import json
import re
from pathlib import Path

import pytest

from docs.make import results
from tests.docs.document_commands import ROOT

PAGES = [
    path
    for path in (*sorted((ROOT / "docs").rglob("*.md")), ROOT / "README.md", ROOT / "CHANGELOG.md")
    if path != results.PAGE and path.name not in ("rig-toml.md", "tables.md", "effects.md", "validation.md")
]
LINK = re.compile(r"\[([^\]]+)\]\((?:\.\./|docs/)*results\.md#([\w-]+)\)")
GENERAL = {"results", "figures"}  # words of links that state no figure
MEASURED = (
    r"\b\d+ of (?!255\b)(?:the |a )?\d+\b",
    r"\b[\d.]+ (?:and [\d.]+ )?times as (?:fast|quick|long)",
    r"\bmillionth\b",
    r"\bcampaign of \d+",
    r"\bmedians? of\b",
    r"\b[\d.]+ (?:s|min|ms) of one core",
    r"\bfalse alarms? in \d",
    r"\bof processor time\b",
    r"\| [\d.]+ %? ?\|",
)


def prose(path: Path) -> str:
    """A page without blocks of code, tables' code and links to results, whose words are held to the files by another
    test.
    """
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("    ")]
    return re.sub(r"`[^`]*`", "", LINK.sub("", "\n".join(lines)))


def test_the_page_is_current():
    assert results.PAGE.read_text(encoding="utf-8") == results.page(), (
        "python -m tests.bench.results NAME .. measures anew and writes it"
    )


@pytest.mark.parametrize("record", results.stored(), ids=lambda record: f"{record['version']}/{record['name']}")
def test_a_kept_result_says_where_it_came_from(record):
    assert re.fullmatch(r"[0-9a-f]{12}", record["commit"]), "measured on a tree that no commit holds"
    assert record["command"].startswith(("python -m tests.bench", "rig ")) and record["created"] and "seed" in record
    assert re.fullmatch(r"\d+\.\d+\.\d+", record["version"]) and {
        "cores",
        "processor",
        "memory_GiB",
        "load",
        "versions",
    } <= set(record["machine"])
    assert record["figures"] and all({"figure", "reached", "wanted"} <= set(row) for row in record["figures"])


def write(folder, version, name, **other):
    machine = {"cores": 2, "processor": "P", "memory_GiB": 8, "load": 0.1, "versions": {"python": "3"}}
    record = {
        "schema": results.SCHEMA,
        "name": name,
        "title": "T",
        "command": "python -m tests.bench x",
        "seed": 1,
        "version": version,
        "commit": "0" * 12,
        "created": "2026-01-01T00:00:00+00:00",
        "machine": machine,
        "figures": [{"figure": "time", "reached": f"{version} s", "wanted": ""}],
        **other,
    }
    (folder / version).mkdir(exist_ok=True)
    (folder / version / f"{name}.json").write_text(json.dumps(record))


def test_the_newest_version_is_shown_with_the_one_before(tmp_path, monkeypatch):
    monkeypatch.setattr(results, "FOLDER", tmp_path)
    for version, name in (("0.9.0", "alone"), ("0.9.0", "fit"), ("0.10.0", "fit"), ("0.2.0", "fit")):
        write(tmp_path, version, name)
    assert [(record["name"], record["version"]) for record in results.newest()] == [
        ("alone", "0.9.0"),
        ("fit", "0.10.0"),
    ]
    page = results.page()
    assert (
        "| time | 0.10.0 s |  | 0.9.0 s |" in page
        and "| figure | reached | wanted | in 0.9.0 |" in page
        and "| time | 0.9.0 s |  |\n" in page
    )


@pytest.mark.parametrize(
    "wrong, says",
    [
        ({"schema": "results/1"}, "schema 'results/1'"),
        ({"version": "0.3.0"}, "version '0.3.0'"),
        ({"name": "lens"}, "'lens' of version"),
    ],
)
def test_a_file_in_the_wrong_place_or_form_is_refused(tmp_path, monkeypatch, wrong, says):
    monkeypatch.setattr(results, "FOLDER", tmp_path / "docs" / "results")
    results.FOLDER.mkdir(parents=True)
    write(results.FOLDER, "0.2.0", "fit")
    path = results.FOLDER / "0.2.0" / "fit.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | wrong))
    with pytest.raises(ValueError, match=says):
        results.stored()


@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_figures_that_link_to_results_say_what_they_say(path):
    reached = {record["name"]: " | ".join(row["reached"] for row in record["figures"]) for record in results.newest()}
    wrong = [
        (words, name)
        for words, name in LINK.findall(path.read_text(encoding="utf-8"))
        if name not in reached or words not in GENERAL and words not in reached[name]
    ]
    assert wrong == []


@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_no_measured_figure_stands_without_its_result(path):
    text = prose(path)
    assert [match.group() for pattern in MEASURED for match in re.finditer(pattern, text)] == []
