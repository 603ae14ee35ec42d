"""Every tutorial has a picture; pictures have words for those who cannot see them, are small, and are drawn by
docs/make.
"""

import re

import pytest
import yaml

from docs.make import figures
from rig.report.pages.html_and_svg_elements import svg_figure
from tests.docs.document_commands import ROOT

LARGEST = 100_000  # bytes of a figure
WORDS = 6  # of an alternative text of a figure, at least
PICTURE = re.compile(r"!\[([^\]]*)\]\(([^)]+)\)")
PAGES = sorted((ROOT / "docs").glob("*.md"))


def tutorials() -> list[str]:
    """The pages under Tutorials in the navigation."""
    nav = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8").split("\nnav:\n")[1])
    entries = next(entry["Tutorials"] for entry in nav if "Tutorials" in entry)
    return [page for entry in entries for page in entry.values()]


@pytest.mark.parametrize("name", tutorials())
def test_a_tutorial_has_a_picture(name):
    assert PICTURE.search((ROOT / "docs" / name).read_text(encoding="utf-8"))


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_pictures_have_alternative_texts(page):
    pictures = PICTURE.findall(page.read_text(encoding="utf-8"))
    assert [name for text, name in pictures if not text.strip()] == []
    assert [name for text, name in pictures if name.startswith("figures/") and len(text.split()) < WORDS] == []


def test_figures_are_those_that_are_drawn_and_small_and_shown():
    paths = {path.name: path for path in figures.FOLDER.iterdir()}
    assert set(paths) == {*(f"{name}.svg" for name in figures.FIGURES), "sheet.png", "assembly.png"}
    assert max(path.stat().st_size for path in paths.values()) <= LARGEST
    shown = {name for page in PAGES for _, name in PICTURE.findall(page.read_text(encoding="utf-8"))}
    assert {f"figures/{name}" for name in paths} <= shown


def test_drawings_are_found_by_their_label():
    first, second = svg_figure(9, "error of position: mm", []), svg_figure(9, "error of rotation: mrad", [])
    page = f"<p>{first}</p>{second}"
    assert figures.drawings(page, ("error of r", "error")) == [second, first]
    with pytest.raises(ValueError, match="no drawing 'strut' among error of position: mm, error of rotation: mrad"):
        figures.drawings(page, ("strut",))


def test_the_sheets_are_drawn(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert [name for name, _ in figures.printed()] == ["sheet", "assembly"]
