"""SVG elements of figures: figure, text, tooltip and ticks; text escaped, measured and wrapped."""

import html
import math
import re
from collections.abc import Sequence

NARROW = {
    ".": 0.32,
    ",": 0.32,
    ":": 0.34,
    " ": 0.32,
    "-": 0.37,
    "i": 0.28,
    "l": 0.28,
    "t": 0.4,
    "r": 0.42,
    "f": 0.36,
    "(": 0.4,
    ")": 0.4,
}
LETTER = (
    0.645  # of a letter's height, the width of a digit and the most of a usual letter in the widest of common typefaces
)


def escape_html(text: str) -> str:
    """Escape text for HTML; um and urad become µm and µrad."""
    return html.escape(re.sub(r"\bu(m|rad)\b", r"µ\1", text))


def text_width(text: str, size: float) -> float:
    """Width of text on a figure, an upper bound, in the unit of `size`, its letters' height."""
    return size * sum(NARROW.get(letter, LETTER) for letter in text)


def wrap_text(text: str, size: float, room: float) -> list[str]:
    """Wrap text into lines no wider than room, a single longer word excepted. size, room : as in `text_width`."""
    lines = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".lstrip()
        if lines[-1] and text_width(longer, size) > room:
            lines.append(word)
        else:
            lines[-1] = longer
    return lines


WIDTH = 400
TEXT = 14  # units of a letter's height; a phone shows a unit as a pixel
SMALL = 12.5  # of small ones


def svg_figure(height: int, title: str, parts: Sequence[str], values: str = "") -> str:
    """SVG figure of parts, WIDTH wide. title : for screen readers; values : attributes with a point's values"""
    return (
        f'<svg class="figure" role="img" viewBox="0 0 {WIDTH} {height}" aria-label="{escape_html(title)}"{values}>'
        + "".join(parts)
        + "</svg>"
    )


def svg_text(x: float, y: float, words: str, anchor: str = "start", style: str = "") -> str:
    """SVG text at a position. anchor : start, middle or end; style : a class of figure.css"""
    named = f' class="{style}"' if style else ""
    return f'<text{named} x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape_html(words)}</text>'


def text_within(box: tuple[float, float, float, float], words: str, style: str = "") -> str:
    r"""SVG text within a box, centred; \"\" where it does not fit. box : (left, top, width, height)"""
    x, y, across, up = box
    size = TEXT if not style else SMALL
    return (
        svg_text(x + across / 2, y + up / 2 + 0.36 * size, words, "middle", style)
        if text_width(words, size) < across - 2 and size < up
        else ""
    )


def tooltip(words: str) -> str:
    """SVG tooltip, to stand within a shape."""
    return f"<title>{escape_html(words)}</title>"


def round_ticks(low: float, high: float, most: int = 5) -> list[float]:
    """Ticks at round numbers within low .. high, `most` at the most. Raises ValueError for an empty range."""
    if not high > low:
        raise ValueError(f"expected a range, got {low:g} .. {high:g}")
    step = 10 ** math.floor(math.log10((high - low) / most))
    step = next(
        step * k for k in (1, 2, 5, 10, 20) if math.floor(high / (step * k)) - math.ceil(low / (step * k)) < most
    )
    return [round(k * step, 12) for k in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)]
