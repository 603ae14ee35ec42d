"""Templates of HTML pages (verdict, next steps, parts) and of standalone SVG files; both need no network."""

import html
import re
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import NamedTuple

from rig.formats.output_files import write_text
from rig.report.pages.html_elements import capitalised, inline_html, list_html
from rig.report.pages.svg_elements import TEXT, WIDTH, escape_html, svg_text, wrap_text
from rig.report.verdict import Verdict

# nothing is fetched from anywhere
SHUT = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:"


class Link(NamedTuple):
    """Another page. label : what it is; path : relative to the page that has the link, with /"""

    label: str
    path: str


@dataclass(frozen=True, slots=True)
class Page:
    """What a page says. kind : of page, "measure"; title : what it is of; verdict; parts : HTML as
    rig.report.pages.html_elements and its figures make it
    next_steps : what to do next, commands between backticks; links : to other pages; scripts : of this page's own,
        JavaScript"""

    kind: str
    title: str
    verdict: Verdict
    parts: Sequence[str]
    next_steps: Sequence[str] = ()
    links: Sequence[Link] = ()
    scripts: Sequence[str] = ()


def write_page(path: Path | str, page: Page) -> None:
    """Write a Page as a self-contained HTML file."""
    write_text(path, page_html(page))


def page_html(page: Page) -> str:
    """HTML of a Page."""
    state, why = page.verdict.state, page.verdict.why
    links = "".join(f'<a href="{html.escape(link.path)}">{html.escape(link.label)}</a>' for link in page.links)
    steps = list_html(map(capitalised, page.next_steps), ordered=len(page.next_steps) > 1)
    style, script = (
        read_asset("theme.css") + read_asset("document.css") + read_asset("figure.css"),
        read_asset("document.js"),
    )
    described = html.escape(f"{state}: {why}")
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" '
        'content="width=device-width, initial-scale=1">'
        f'<meta http-equiv="Content-Security-Policy" content="{SHUT}"><meta name="color-scheme" content="light dark">'
        f'<meta name="generator" content="rig {html.escape(page.kind)}"><meta name="description" content="{described}">'
        f"<title>{html.escape(page.title)}</title><style>{style}</style></head>\n<body>\n"
        f'<header class="{state}"><p class="verdict"><strong>{state}</strong> '
        f"{inline_html(capitalised(why))}.</p><h1>{html.escape(page.title)}</h1>"
        + (f'<nav aria-label="other pages">{links}</nav>' if links else "")
        + "</header>\n<main>\n"
        + (f'<section class="next"><h2>What to do next</h2>{steps}</section>\n' if page.next_steps else "")
        + "\n".join(page.parts)
        + "\n</main>\n"
        + "".join(f'<script type="module">{code}</script>\n' for code in (script, *page.scripts))
        + "</body></html>\n"
    )


def read_asset(name: str) -> str:
    """Read an asset of pages: the text of a stylesheet or script."""
    return resources.files("rig.report.pages").joinpath(name).read_text(encoding="utf-8")


BETWEEN, EDGE, LINE = 10, 6, 18  # units between figures, around them, and of a line of words


def standalone_svg(title: str, words: str, figures: Sequence[str]) -> str:
    """Standalone SVG text of figures, one below the other. title : for those who cannot see it; words :
    above them
    Raises ValueError for what is no figure
    """
    lines = wrap_text(words, TEXT, WIDTH)
    parts = [
        f'<svg class="figure">{svg_text(EDGE + 4, EDGE + 14 + LINE * k, line, style="soft")}</svg>'
        for k, line in enumerate(lines)
    ]
    below = EDGE + LINE * len(lines) + BETWEEN
    for figure in figures:
        found = re.match(rf'<svg class="figure" role="img" viewBox="0 0 {WIDTH} (\d+)"', figure)
        if found is None:
            raise ValueError(f"expected a figure as rig.report.pages.svg_elements makes it, got {figure[:60]!r}")
        high = int(found[1])
        parts.append(figure.replace("<svg ", f'<svg x="{EDGE}" y="{below}" width="{WIDTH}" height="{high}" ', 1))
        below += high + BETWEEN
    across, down = WIDTH + 2 * EDGE, below - BETWEEN + EDGE
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" role="img" width="{across}" height="{down}" viewBox="0 0 '
        f'{across} {down}">'
        f"<title>{escape_html(title)}</title><style>{read_asset('theme.css')}{read_asset('figure.css')}</style>"
        '<rect width="100%" height="100%" rx="8" style="fill:var(--card)"/>' + "\n".join(parts) + "</svg>\n"
    )
