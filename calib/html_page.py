"""Pages that a rig's owner can read offline: one self-contained HTML file each, figures drawn into it."""

import html
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from calib.picture import picture
from rig.files import write_text

STYLE = """body{font:15px/1.5 system-ui,sans-serif;max-width:1000px;margin:2em auto;padding:0 1em;color:#1a1a1a}
h1{font-size:1.5em}h2{font-size:1.15em;margin-top:2em}img{max-width:100%}table{border-collapse:collapse;margin:1em 0}
td,th{padding:.25em .8em;border-bottom:1px solid #ddd;text-align:right}td:first-child,th:first-child{text-align:left}
.note{color:#666;font-size:.9em}table{display:block;overflow-x:auto}
@media(prefers-color-scheme:dark){body{background:#161616;color:#e4e4e4}td,th{border-color:#444}.note{color:#aaa}img{background:#fff}}"""


def page(path: Path | str, title: str, parts: Sequence[str | Figure]) -> None:
    """Write a self-contained HTML page. parts : strings of HTML and matplotlib Figures, in order."""
    body = "\n".join(picture(part) if isinstance(part, Figure) else part for part in parts)
    text = ('<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport content="width=device-width">'
            f'<meta name=color-scheme content="light dark"><title>{html.escape(title)}</title><style>{STYLE}</style>'
            f"<h1>{html.escape(title)}</h1>\n{body}\n</html>\n")
    write_text(path, text)


def table(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """HTML of a table: header and rows of text."""
    def cells(row: Sequence[Any], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{html.escape(str(cell))}</{tag}>" for cell in row) + "</tr>"

    return "<table>" + cells(header, "th") + "".join(cells(row, "td") for row in rows) + "</table>"


def coverage(vectors: np.ndarray) -> Figure:
    """Figure of where poses lie: vectors (n, 6) position (m) and rotation vector (rad)."""
    figure = Figure(figsize=(11, 3.2), layout="constrained")
    axes = figure.subplots(1, 3)
    for a, (i, j) in zip(axes[:2], ((0, 1), (0, 2))):
        a.plot(vectors[:, i] * 1e3, vectors[:, j] * 1e3, ".", ms=4)
        a.set(xlabel=f"{'xyz'[i]}, mm", ylabel=f"{'xyz'[j]}, mm")
    for k, name in enumerate(("rx", "ry", "rz")):
        axes[2].plot(np.degrees(vectors[:, 3 + k]), ".", ms=3, label=name)
    axes[2].set(xlabel="solved frame", ylabel="rotation vector, degrees")
    axes[2].legend(fontsize=8)
    return figure
