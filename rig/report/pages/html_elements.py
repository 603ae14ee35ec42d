"""What a page is made of, as HTML: headings, paragraphs, notes, tables that scroll, parts that are folded."""

import html
import re
from collections.abc import Iterable, Sequence
from typing import Any

from rig.report.pages.text_layout import escape_html

LONG = 30  # letters, beyond which a cell breaks its lines
WORDY = 12  # letters, beyond which a heading of a column does


def inline_html(line: str) -> str:
    """HTML of a line of text; what stands between backticks is a command."""
    parts = enumerate(re.split("`([^`]+)`", line))
    return "".join(f"<code>{html.escape(part)}</code>" if k % 2 else escape_html(part) for k, part in parts)


def capitalised(line: str) -> str:
    """A line that begins with a capital letter; a name that has one within, or a sign, stays as it is."""
    first, *rest = line.split(" ", 1)
    return line[:1].upper() + line[1:] if rest and first.isalpha() and first.islower() else line


def heading(line: str, level: int = 2) -> str:
    """A heading. level : 2 of a section, 3 within one"""
    return f"<h{level}>{inline_html(line)}</h{level}>"


def paragraph(line: str) -> str:
    """A paragraph of text."""
    return f"<p>{inline_html(line)}</p>"


def note(line: str) -> str:
    """What a figure or a table means, in smaller type."""
    return f'<p class="note">{inline_html(line)}</p>'


def list_html(lines: Iterable[str], ordered: bool = False) -> str:
    """Lines below each other, numbered where they are ordered."""
    tag = "ol" if ordered else "ul"
    return f"<{tag}>" + "".join(f"<li>{inline_html(line)}</li>" for line in lines) + f"</{tag}>"


def table(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """A table that scrolls where it is wider than the page. header : of its columns, "" for one without; rows : of text
    and numbers
    """
    lines = [[str(cell) for cell in row] for row in rows]
    said = [_of_text(column) for column in zip(*lines)] or [False] * len(header)
    head = "".join(
        f'<th scope="col"{_style(cell, text, WORDY)}>{escape_html(cell)}</th>' if cell else "<td></td>"
        for cell, text in zip(header, said)
    )
    cells = [
        [f"<td{_style(cell, text, LONG)}>{escape_html(cell)}</td>" for cell, text in zip(line, said)] for line in lines
    ]
    body = "".join(f"<tr>{''.join(row)}</tr>" for row in cells)
    name = escape_html(", ".join(filter(None, header)))
    return (
        '<div class="scroll" tabindex="0" role="group" aria-label="table of '
        f'{name}"><table><tr>{head}</tr>{body}</table></div>'
    )


def _of_text(column: Sequence[str]) -> bool:
    """Whether a column is of text, which begins at its left; of numbers, which end at its right, it is when half of its
    cells begin with one.
    """
    said = [cell for cell in column if cell]
    return 2 * sum(re.match(r"[-+±]?[\d.]", cell) is not None for cell in said) < len(said)


def _style(cell: str, text: bool, long: int) -> str:
    classes = ["text"] * text + ["long"] * (len(cell) > long) + ["wraps"] * (text and WORDY < len(cell) <= long)
    return f' class="{" ".join(classes)}"' if classes else ""


def folding_section(summary: str, *parts: str) -> str:
    """Parts that are shown when asked for."""
    return f"<details><summary>{inline_html(summary)}</summary>" + "".join(parts) + "</details>"
