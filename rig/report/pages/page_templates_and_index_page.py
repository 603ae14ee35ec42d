"""Page templates, and the index page.

Pages are HTML files; the index states a project's latest state, and lists all pages of its folder by stage.
"""

import html
import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote

from rig.errors import RigError
from rig.formats.output_files import CommandOutputs, write_text
from rig.report import verdict_refutations_and_result_display
from rig.report.pages.html_and_svg_elements import (
    TEXT,
    WIDTH,
    capitalise_unless_name_or_sign,
    escape_html,
    heading_html,
    inline_html,
    list_html,
    note_html,
    section_html,
    split_text_at_semicolons,
    svg_text,
    wrap_text,
)
from rig.report.pages.project_stages_and_files_without_pages import (
    STAGES,
    ProjectFile,
    list_project_files,
    local_date_and_time_text,
    stage_of_page_kind,
)
from rig.report.verdict_refutations_and_result_display import WORST, State, Verdict, worst_state

# nothing is fetched from anywhere
SHUT = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:"


class Link(NamedTuple):
    """Another page. label : what it is; path : relative to the page that has the link, with /"""

    label: str
    path: str


@dataclass(frozen=True, slots=True)
class Page:
    """Content of a page. kind : of page, "measure"; title : what it is of; verdict; parts : HTML as
    rig.report.pages.page_templates_and_index_page and its figures make it
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
    """Write a Page as an HTML file.

    It is self-contained.
    """
    write_text(path, page_html(page))


def page_html(page: Page) -> str:
    """HTML of a Page."""
    state, why = page.verdict.state, page.verdict.why
    links = "".join(f'<a href="{html.escape(link.path)}">{escape_html(link.label)}</a>' for link in page.links)
    steps = list_html(map(capitalise_unless_name_or_sign, page.next_steps), ordered=len(page.next_steps) > 1)
    style, script = (
        read_page_stylesheet_or_script("theme.css")
        + read_page_stylesheet_or_script("document.css")
        + read_page_stylesheet_or_script("figure.css"),
        read_page_stylesheet_or_script("document.js"),
    )
    described = html.escape(f"{state}: {why}")
    first, *doubts = split_text_at_semicolons(why)
    more = f'<div class="doubts">{list_html(map(capitalise_unless_name_or_sign, doubts))}</div>' if doubts else ""
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" '
        'content="width=device-width, initial-scale=1">'
        f'<meta http-equiv="Content-Security-Policy" content="{SHUT}"><meta name="color-scheme" content="light dark">'
        f'<meta name="generator" content="rig {html.escape(page.kind)}"><meta name="description" content="{described}">'
        f"<title>{html.escape(page.title)}</title><style>{style}</style></head>\n<body>\n"
        f'<header class="{state}"><p class="verdict"><strong>{state}</strong> '
        f"{inline_html(capitalise_unless_name_or_sign(first))}.</p>{more}<h1>{escape_html(page.title)}</h1>"
        + (f'<nav aria-label="other pages">{links}</nav>' if links else "")
        + "</header>\n<main>\n"
        + (f'<section class="next"><h2>What to do next</h2>{steps}</section>\n' if page.next_steps else "")
        + "\n".join(page.parts)
        + "\n</main>\n"
        + "".join(f'<script type="module">{code}</script>\n' for code in (script, *page.scripts))
        + "</body></html>\n"
    )


def read_page_stylesheet_or_script(name: str) -> str:
    """Read a stylesheet or script of pages by its name."""
    return resources.files("rig.report.pages").joinpath(name).read_text(encoding="utf-8")


BETWEEN, EDGE, LINE = 10, 6, 18  # units between figures, around them, and of a line of words


def standalone_svg(title: str, words: str, figures: Sequence[str]) -> str:
    """Standalone SVG of figures.

    They are one below the other.
    title : for those who cannot see it; words : above them. Raises ValueError for what is no figure
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
            raise ValueError(
                f"expected a figure as rig.report.pages.page_templates_and_index_page makes it, got {figure[:60]!r}"
            )
        high = int(found[1])
        parts.append(figure.replace("<svg ", f'<svg x="{EDGE}" y="{below}" width="{WIDTH}" height="{high}" ', 1))
        below += high + BETWEEN
    across, down = WIDTH + 2 * EDGE, below - BETWEEN + EDGE
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" role="img" width="{across}" height="{down}" viewBox="0 0 '
        f'{across} {down}">'
        f"<title>{escape_html(title)}</title>"
        f"<style>{read_page_stylesheet_or_script('theme.css')}{read_page_stylesheet_or_script('figure.css')}</style>"
        '<rect width="100%" height="100%" rx="8" style="fill:var(--card)"/>' + "\n".join(parts) + "</svg>\n"
    )


NAME = "index.html"
KIND = "index"
DEPTH = 3  # folders down to which pages are looked for, and up to which an index is
LATER_STAGES = {
    "Verification": ("verified", "rig verify calibration.json REC --page verified.html"),
    "Certificate": ("certified", "rig certify calibration.json REC --out certificate.html"),
    "Diagnosis": ("diagnosed", "rig diagnose REC --out found"),
}  # stage: participle, and the command that makes its page; what an index states of the latest calibration
HEAD = 8192  # characters in which a page says what it is
PAGE_HEAD = re.compile(
    '<meta name="generator" content="rig ([a-z]+)"><meta name="description" content="([^:"]*): '
    '([^"]*)"><title>([^<]*)</title>'
)


@dataclass(frozen=True, slots=True)
class PageSummary:
    """A page. path; kind, title, state, why : as it states them, and as later recordings have it; changed : s, when it
    was written
    """

    path: Path
    kind: str
    title: str
    state: State
    why: str
    changed: float


def read_page_summary(path: Path) -> PageSummary | None:
    """Read the summary of a page.

    Kind, title, verdict, later refutations; None for a file that is no page of rig.
    Raises FileError for a list of refuted results that is none
    """
    try:
        with path.open(encoding="utf-8") as file:
            found = PAGE_HEAD.search(file.read(HEAD))
        changed = path.stat().st_mtime
    except (OSError, UnicodeDecodeError):
        return None
    if found is None or found[2] not in list(State):
        return None
    later = verdict_refutations_and_result_display.refutations_of_file(path.with_suffix(".json"))
    state, why = (
        worst_state([State(found[2]), *(one.state for one in later)]),
        "; ".join([*(one.line for one in later), html.unescape(found[3])]),
    )
    return PageSummary(path, found[1], html.unescape(found[4]), state, why, changed)


def list_pages_below_folder(folder: Path) -> list[PageSummary]:
    """List the pages in a folder and below it.

    The latest first, indices excluded.
    """
    places = [path for depth in range(DEPTH) for path in sorted(folder.glob("*/" * depth + "*.html"))]
    known = [found for path in places if (found := read_page_summary(path)) is not None and found.kind != KIND]
    return sorted(known, key=lambda found: -found.changed)


def write_index_page(path: Path, folder: Path) -> None:
    """Write the index page of a folder.

    A project's latest state, then all pages and files, stage by stage.
    path : where it is written before it moves into that folder.
    """
    pages, files = list_pages_below_folder(folder), list_project_files(folder, DEPTH)
    stages: dict[str, list[tuple[float, str]]] = {stage: [] for stage in STAGES}
    for page in pages:
        stages[stage_of_page_kind(page.kind)].append((page.changed, _page_html(page, folder)))
    for file in files:
        stages[file.stage].append((file.changed, _file_html(file, folder)))
    verdict, parts = _latest_state(pages, folder)
    for stage, entries in stages.items():
        items = "".join(f"<li>{item}</li>" for _, item in sorted(entries))
        parts += section_html(stage, [f'<ul class="pages">{items}</ul>'] if items else [])
    steps = [] if pages else ["Begin with a recording: `rig measure REC --out measured`"]
    write_page(path, Page(KIND, folder.resolve().name, verdict, parts, steps))


def _latest_state(pages: Sequence[PageSummary], folder: Path) -> tuple[Verdict, list[str]]:
    """(Verdict, HTML) of the latest calibration and what was found of it since. pages : the latest first"""
    calibrated = next((page for page in pages if page.kind == "calibrate"), None)
    if calibrated is None:
        count = {state: sum(page.state == state for page in pages) for state in WORST}
        why = ", ".join(f"{count[state]} {state}" for state in WORST if count[state]) or "there is no page yet"
        return Verdict(worst_state([page.state for page in pages]), why), []
    states, lines = (
        [calibrated.state],
        [f"calibrated {local_date_and_time_text(calibrated.changed)}: {calibrated.state}"],
    )
    cards = [f"{heading_html('Calibration', 3)}<p>{_page_html(calibrated, folder)}</p>"]
    for stage, (participle, step) in LATER_STAGES.items():
        found = next((page for page in pages if page.kind in STAGES[stage]), None)
        if found is not None and found.changed >= calibrated.changed:
            states.append(found.state)
            lines.append(f"{participle} {local_date_and_time_text(found.changed)}: {found.state}")
            cards.append(f"{heading_html(stage, 3)}<p>{_page_html(found, folder)}</p>")
        else:
            lines.append(f"not {participle} since")
            cards.append(f"{heading_html(stage, 3)}{note_html(f'No page is newer than the calibration: `{step}`')}")
    panels = "".join(f"<section>{card}</section>" for card in cards)
    return Verdict(worst_state(states), "; ".join(lines)), [heading_html("Now"), f'<div class="panels">{panels}</div>']


def _page_html(page: PageSummary, folder: Path) -> str:
    why = inline_html(split_text_at_semicolons(page.why)[0])
    return (
        f'<span class="badge {page.state}">{page.state}</span> <a href="{_relative_link(page.path, folder)}">'
        f'{html.escape(page.title)}</a><br><span class="note">{local_date_and_time_text(page.changed)}: {why}</span>'
    )


def _file_html(file: ProjectFile, folder: Path) -> str:
    name = file.path.resolve().relative_to(folder.resolve()).as_posix()
    return (
        f'<a href="{_relative_link(file.path, folder)}">{html.escape(name)}</a>'
        f'<br><span class="note">{local_date_and_time_text(file.changed)}: {inline_html(file.text)}</span>'
    )


def _index_above(place: Path) -> Path | None:
    """The index in the folder of a page or in one above it, None where there is none."""
    folders = (place.resolve().parent, *place.resolve().parents[1:DEPTH])
    return next(
        (
            folder / NAME
            for folder in folders
            if (found := read_page_summary(folder / NAME)) is not None and found.kind == KIND
        ),
        None,
    )


def refresh_index_pages_above(written_pages: Iterable[Path]) -> None:
    """Refresh the index pages above pages that were written.

    One that a user changed is left.
    """
    for index in {
        index
        for place in written_pages
        if place.suffix == ".html" and place.name != NAME and (index := _index_above(place)) is not None
    }:
        with CommandOutputs(KIND) as outputs:
            try:
                place = outputs.file(index)
            except RigError:  # it is somebody else's by now, or the folder cannot be written
                continue
            write_index_page(place, index.parent)


def index_and_source_links(page_file: Path, sources: Iterable[Path] = ()) -> list[Link]:
    """Links of a page to the index and to its sources.

    To the index above it, and to the pages of its sources, folders or files.
    """
    index, own = _index_above(page_file), page_file.resolve()
    near = [
        path
        for source in sources
        for path in (sorted(source.glob("*.html")) if source.is_dir() else [source.with_suffix(".html")])
    ]
    known = [
        found
        for path in near
        if path.resolve() != own and (found := read_page_summary(path)) is not None and found.kind != KIND
    ]
    first = [] if index is None else [Link("All pages", _relative_link(index, own.parent))]
    return [*first, *(Link(found.title, _relative_link(found.path, own.parent)) for found in known)]


def _relative_link(path: Path, folder: Path) -> str:
    return quote(os.path.relpath(path.resolve(), folder.resolve()).replace(os.sep, "/"))
