"""Figures as a file of their own, for documents: one SVG with its style, light or dark as the reader's computer is."""

import re
from collections.abc import Sequence

from rig.report.pages.page_template import read_asset
from rig.report.pages.svg_elements import TEXT, WIDTH, text
from rig.report.pages.text_layout import escape_html, wrap_text

BETWEEN, EDGE, LINE = 10, 6, 18  # units between figures, around them, and of a line of words


def standalone_svg(title: str, words: str, figures: Sequence[str]) -> str:
    """Text of an SVG file of figures as rig.report.pages.svg_elements makes them, one below the other. title : for
    those who cannot see it;
    words : above them
    Raises ValueError for what is no figure"""
    lines = wrap_text(words, TEXT, WIDTH)
    parts = [
        f'<svg class="figure">{text(EDGE + 4, EDGE + 14 + LINE * k, line, style="soft")}</svg>'
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
