"""Every figure of every page says what is drawn and how good and bad ones look; pages that take long are read by the
tests in a browser.
"""

import pytest

from docs.make import project
from rig.report.pages.html_and_svg_elements import figures_with_caption_html, svg_figure
from tests.rig.report.figure_captions import unexplained_drawings
from tests.rig.report.made_pages import write_made_pages

CAPTION = "Dots: errors (mm) of each pose. Good: near 0. Bad: a trend."


def test_what_has_no_caption_is_found():
    drawn = svg_figure(10, "errors", [])
    assert unexplained_drawings(figures_with_caption_html(drawn, CAPTION)) == []
    assert unexplained_drawings(drawn) == ["errors"]
    assert unexplained_drawings(figures_with_caption_html(drawn, "errors")) == ["errors"]
    assert unexplained_drawings(figures_with_caption_html("", CAPTION) + drawn) == ["errors"]
    assert unexplained_drawings(f"<figure>{drawn}<figcaption>{CAPTION}</figcaption></figure>{drawn}") == ["errors"]


def test_pages_whose_commands_take_minutes_have_captions(tmp_path):
    for page in write_made_pages(tmp_path).values():
        text = page.read_text(encoding="utf-8")
        assert 'class="figure"' in text and unexplained_drawings(text) == [], page.name


@pytest.mark.slow
def test_pages_of_a_project_have_captions(tmp_path):
    pages = project.quick(tmp_path / "project")
    assert len(pages) > 10
    assert {kind: unexplained_drawings(page.read_text(encoding="utf-8")) for kind, page in pages.items()} == {
        kind: [] for kind in pages
    }
