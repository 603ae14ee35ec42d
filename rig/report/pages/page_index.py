"""Index page of all pages below a folder, each with its verdict, the latest first; refreshed by commands."""

import html
import os
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from rig.errors import RigError
from rig.formats.output_files import Outputs
from rig.report import refutations
from rig.report.pages.html_elements import capitalised, heading, inline_html
from rig.report.pages.page_and_svg_templates import Link, Page, write_page
from rig.report.verdict import WORST, State, Verdict, worst_state

NAME = "index.html"
KIND = "index"
DEPTH = 3  # folders down to which pages are looked for, and up to which an index is
HEAD = 8192  # characters in which a page says what it is
SAID = re.compile(
    '<meta name="generator" content="rig ([a-z]+)"><meta name="description" content="([^:"]*): '
    '([^"]*)"><title>([^<]*)</title>'
)


@dataclass(frozen=True, slots=True)
class PageSummary:
    """A page. path; kind, title, state, why : as it says them, and as later recordings have it; changed : s, when it
    was written
    """

    path: Path
    kind: str
    title: str
    state: State
    why: str
    changed: float


def read_page_summary(path: Path) -> PageSummary | None:
    """Summary of a page: kind, title, verdict, later refutations; None for a file that is no page of rig.

    Raises FileError for a list of refuted results that is none
    """
    try:
        with path.open(encoding="utf-8") as file:
            said = SAID.search(file.read(HEAD))
        changed = path.stat().st_mtime
    except (OSError, UnicodeDecodeError):
        return None
    if said is None or said[2] not in list(State):
        return None
    later = refutations.refutations_of_file(path.with_suffix(".json"))
    state, why = (
        worst_state([State(said[2]), *(one.state for one in later)]),
        "; ".join([*(one.line for one in later), html.unescape(said[3])]),
    )
    return PageSummary(path, said[1], html.unescape(said[4]), state, why, changed)


def list_pages(folder: Path) -> list[PageSummary]:
    """List the pages in a folder and below it, the latest first, indices excluded."""
    places = [path for depth in range(DEPTH) for path in sorted(folder.glob("*/" * depth + "*.html"))]
    known = [found for path in places if (found := read_page_summary(path)) is not None and found.kind != KIND]
    return sorted(known, key=lambda found: -found.changed)


def write_index_page(path: Path, folder: Path) -> None:
    """Write the index page of all pages of a folder. path : where it is written before it moves into that folder"""
    known = list_pages(folder)
    count = {state: sum(found.state == state for found in known) for state in WORST}
    state = worst_state([found.state for found in known])
    why = ", ".join(f"{count[state]} {state}" for state in WORST if count[state]) or "there is no page yet"
    items = "".join(
        f'<li><span class="badge {found.state}">{found.state}</span> <a '
        f'href="{_relative_link(found.path, folder)}">{html.escape(found.title)}</a>'
        f'<br><span class="note">{inline_html(capitalised(found.why))}</span></li>'
        for found in known
    )
    parts = [heading("Pages"), f'<ul class="pages">{items}</ul>'] if known else []
    steps = [] if known else ["Begin with a recording: `rig measure REC --out measured`"]
    write_page(path, Page(KIND, folder.resolve().name, Verdict(state, why), parts, steps))


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


def refresh_indices(written: Iterable[Path]) -> None:
    """Refresh the index pages above pages that were written; one that a user changed is left."""
    for index in {
        index
        for place in written
        if place.suffix == ".html" and place.name != NAME and (index := _index_above(place)) is not None
    }:
        with Outputs(KIND) as outputs:
            try:
                place = outputs.file(index)
            except RigError:  # it is somebody else's by now, or the folder cannot be written
                continue
            write_index_page(place, index.parent)


def index_and_source_links(place: Path, sources: Iterable[Path] = ()) -> list[Link]:
    """Links of a page at a place: to the index above it, and to the pages of its sources, folders or files."""
    index, own = _index_above(place), place.resolve()
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
