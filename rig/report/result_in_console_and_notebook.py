"""Display of results in console and notebook.

One line in a console, HTML in a notebook.
"""

from collections.abc import Iterable, Sequence
from html import escape


class OneLineRepr:
    """Base of results whose repr is one line, the class's name and what str gives; for dataclasses with repr=False."""

    __slots__ = ()

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {str(self).partition(chr(10))[0]}>"


def result_html(heading: str, lines: Iterable[str] = (), table: Sequence[Sequence[str]] = ()) -> str:
    """HTML of a result for notebooks.

    Heading, sentences, a table whose first row is its header; text is escaped.
    """
    parts = [f"<strong>{escape(heading)}</strong>", *(f"<p style='margin:.2em 0'>{escape(line)}</p>" for line in lines)]
    if table:
        head, *rows = table
        body = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows)
        top = "".join(f"<th>{escape(cell)}</th>" for cell in head)
        parts.append(
            f"<div style='overflow-x:auto'><table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>"
        )
    return f"<div>{''.join(parts)}</div>"
