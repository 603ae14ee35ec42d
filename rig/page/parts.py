"""What a page is made of, as HTML: headings, paragraphs, notes, tables that scroll, parts that are folded."""

import html
import re
from collections.abc import Iterable, Sequence
from typing import Any

LONG = 40  # letters, beyond which a cell breaks its lines


def words(line: str) -> str:
    """HTML of a line of text; what stands between backticks is a command."""
    return re.sub("`([^`]+)`", r"<code>\1</code>", html.escape(line))


def heading(line: str, level: int = 2) -> str:
    """A heading. level : 2 of a section, 3 within one"""
    return f"<h{level}>{words(line)}</h{level}>"


def paragraph(line: str) -> str:
    """A paragraph of text."""
    return f"<p>{words(line)}</p>"


def note(line: str) -> str:
    """What a figure or a table means, in smaller type."""
    return f'<p class="note">{words(line)}</p>'


def listed(lines: Iterable[str], ordered: bool = False) -> str:
    """Lines below each other, numbered where they are ordered."""
    tag = "ol" if ordered else "ul"
    return f"<{tag}>" + "".join(f"<li>{words(line)}</li>" for line in lines) + f"</{tag}>"


def table(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """A table that scrolls where it is wider than the page. header : of its columns, "" for one without; rows : of text and numbers"""
    head = "".join(f'<th scope="col">{html.escape(cell)}</th>' if cell else "<td></td>" for cell in header)
    body = "".join("<tr>" + "".join(map(_cell, row)) + "</tr>" for row in rows)
    name = html.escape(", ".join(filter(None, header)))
    return f'<div class="scroll" tabindex="0" role="group" aria-label="table of {name}"><table><tr>{head}</tr>{body}</table></div>'


def _cell(cell: Any) -> str:
    text = str(cell)
    return f"<td{' class=long' if len(text) > LONG else ''}>{html.escape(text)}</td>"


def folded(summary: str, *parts: str) -> str:
    """Parts that are shown when asked for."""
    return f"<details><summary>{words(summary)}</summary>" + "".join(parts) + "</details>"
