"""A result as a notebook shows it: a heading, sentences, and a table that scrolls."""

from collections.abc import Iterable, Sequence
from html import escape


def result_html(heading: str, lines: Iterable[str] = (), table: Sequence[Sequence[str]] = ()) -> str:
    """HTML of a result: heading, sentences, rows of a table, the first of which heads it; all of it text as it is."""
    parts = [f"<strong>{escape(heading)}</strong>", *(f"<p style='margin:.2em 0'>{escape(line)}</p>" for line in lines)]
    if table:
        head, *rows = table
        body = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows)
        top = "".join(f"<th>{escape(cell)}</th>" for cell in head)
        parts.append(
            f"<div style='overflow-x:auto'><table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>"
        )
    return f"<div>{''.join(parts)}</div>"
