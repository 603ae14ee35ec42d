"""Figures as SVG drawn into a page: readable on a phone, in the page's own colours by day and by night."""

import html
from collections.abc import Sequence

WIDTH = 400
STYLE = """svg.figure{width:100%;max-width:640px;display:block;font:12px system-ui,sans-serif;fill:currentColor}
svg.figure .axis{stroke:currentColor;stroke-opacity:.5;fill:none}svg.figure .line{stroke:#2a78c2;stroke-width:2;fill:none}
svg.figure .before{stroke:#c2722a}svg.figure .mark{stroke:#c22a4e;stroke-dasharray:5 3;fill:none}svg.figure .bar{fill:#2a78c2}
svg.figure .measuring{fill:#8a8a8a}svg.figure .cell{fill:#2a78c2;stroke:currentColor;stroke-opacity:.5}
svg.figure .lost{fill:#c22a4e}svg.figure .gained{fill:#2a9d5c}svg.figure .small{font-size:9px}
@media(prefers-color-scheme:dark){svg.figure .line{stroke:#6db3f2}svg.figure .bar,svg.figure .cell{fill:#3d8fd9}svg.figure .mark{stroke:#ff6b8b}
svg.figure .cell.lost{fill:#ff6b8b}svg.figure .cell.gained{fill:#4cc98a}}"""


def svg(height: int, title: str, parts: Sequence[str]) -> str:
    """A figure of parts, WIDTH wide, with a title for those who cannot see it."""
    return (f'<svg class="figure" role="img" viewBox="0 0 {WIDTH} {height}" aria-label="{html.escape(title)}"><title>{html.escape(title)}</title>'
            + "".join(parts) + "</svg>")


def text(x: float, y: float, words: str, anchor: str = "start", style: str = "") -> str:
    """Words at a place of a figure. anchor : start, middle or end; style : a class of STYLE"""
    named = f' class="{style}"' if style else ""
    return f'<text{named} x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{html.escape(words)}</text>'
