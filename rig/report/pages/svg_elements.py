"""Figures as SVG drawn into a page: readable on a phone, in the page's own colours by day and by night; figure.css has
their classes.
"""

import math
from collections.abc import Sequence

from rig.report.pages.text_layout import escape_html, text_width

WIDTH = 400
TEXT = 14  # units of a letter's height; a phone shows a unit as a pixel
SMALL = 12.5  # of small ones


def svg(height: int, title: str, parts: Sequence[str], values: str = "") -> str:
    """A figure of parts, WIDTH wide, with a title for those who cannot see it. values : attributes that tell a point's
    values
    """
    return (
        f'<svg class="figure" role="img" viewBox="0 0 {WIDTH} {height}" aria-label="{escape_html(title)}"{values}>'
        + "".join(parts)
        + "</svg>"
    )


def text(x: float, y: float, words: str, anchor: str = "start", style: str = "") -> str:
    """Words at a place of a figure. anchor : start, middle or end; style : a class of figure.css"""
    named = f' class="{style}"' if style else ""
    return f'<text{named} x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape_html(words)}</text>'


def text_within(box: tuple[float, float, float, float], words: str, style: str = "") -> str:
    """Words in the middle of a box, nothing where they do not fit in. box : (left, top, width, height)"""
    x, y, across, up = box
    size = TEXT if not style else SMALL
    return (
        text(x + across / 2, y + up / 2 + 0.36 * size, words, "middle", style)
        if text_width(words, size) < across - 2 and size < up
        else ""
    )


def tooltip(words: str) -> str:
    """What a shape says when it is pointed at, to stand within it."""
    return f"<title>{escape_html(words)}</title>"


def round_ticks(low: float, high: float, most: int = 5) -> list[float]:
    """Round figures within low .. high, `most` at the most. Raises ValueError for an empty range."""
    if not high > low:
        raise ValueError(f"expected a range, got {low:g} .. {high:g}")
    step = 10 ** math.floor(math.log10((high - low) / most))
    step = next(
        step * k for k in (1, 2, 5, 10, 20) if math.floor(high / (step * k)) - math.ceil(low / (step * k)) < most
    )
    return [round(k * step, 12) for k in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)]
