"""HTML elements of pages: headings, paragraphs, notes, lists, tables, folding sections; results in notebooks."""

import html
import re
from collections.abc import Iterable, Sequence
from html import escape

from rig.report.pages.svg_elements import escape_html


def result_html(heading: str, lines: Iterable[str] = (), table: Sequence[Sequence[str]] = ()) -> str:
    """HTML of a result for notebooks: heading, sentences, a table whose first row is its header; text is escaped."""
    parts = [f"<strong>{escape(heading)}</strong>", *(f"<p style='margin:.2em 0'>{escape(line)}</p>" for line in lines)]
    if table:
        head, *rows = table
        body = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows)
        top = "".join(f"<th>{escape(cell)}</th>" for cell in head)
        parts.append(
            f"<div style='overflow-x:auto'><table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>"
        )
    return f"<div>{''.join(parts)}</div>"


LONG = 30  # letters, beyond which a cell breaks its lines
WORDY = 12  # letters, beyond which a heading of a column does


def inline_html(line: str) -> str:
    """Inline HTML of a line of text; text between backticks becomes <code>."""
    parts = enumerate(re.split("`([^`]+)`", line))
    return "".join(f"<code>{html.escape(part)}</code>" if k % 2 else escape_html(part) for k, part in parts)


def capitalised(line: str) -> str:
    """Line with its first letter capitalised, unless its first word is a name, a sign or already capitalised."""
    first, *rest = line.split(" ", 1)
    return line[:1].upper() + line[1:] if rest and first.isalpha() and first.islower() else line


def heading(line: str, level: int = 2) -> str:
    """HTML of a heading. level : 2 of a section, 3 within one"""
    return f"<h{level}>{inline_html(line)}</h{level}>"


def paragraph(line: str) -> str:
    """HTML of a paragraph."""
    return f"<p>{inline_html(line)}</p>"


def note(line: str) -> str:
    """HTML of a note in smaller type, which explains a figure or table."""
    return f'<p class="note">{inline_html(line)}</p>'


def list_html(lines: Iterable[str], ordered: bool = False) -> str:
    """HTML of a list of lines, numbered where ordered."""
    tag = "ol" if ordered else "ul"
    return f"<{tag}>" + "".join(f"<li>{inline_html(line)}</li>" for line in lines) + f"</{tag}>"


def table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    r"""HTML of a scrolling table. header : of its columns, \"\" for one without; rows : of text and numbers"""
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
    """HTML of a folding section: a summary line, and parts shown when it is opened."""
    return f"<details><summary>{inline_html(summary)}</summary>" + "".join(parts) + "</details>"
