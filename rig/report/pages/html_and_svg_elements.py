"""HTML and SVG elements of pages and figures."""

import html
import math
import re
from collections.abc import Iterable, Sequence

NARROW = {
    **dict.fromkeys(".,: ", 0.32), "-": 0.37, "i": 0.28, "l": 0.28, "t": 0.4, "r": 0.42, "f": 0.36, "(": 0.4, ")": 0.4,
}  # fmt: skip
LETTER = (
    0.645  # of a letter's height, the width of a digit and the most of a usual letter in the widest of common typefaces
)


SIGNS = {  # of a terminal, as patterns, and of print
    r"\bu(m|rad)\b": r"µ\1", r"(?<!\S)->(?!\S)": "→", r"(?<!\S)\+-(?=[\s\d])": "±", "<=": "≤", ">=": "≥",
    r"(?<=[a-z])\^2\b": "²",
}  # fmt: skip


def escape_html(text: str) -> str:
    """Escape text for HTML.

    The signs of print stand for those of a terminal.
    Such signs are μm, →, ±, ≤, ≥, ².
    """
    for pattern, sign in SIGNS.items():
        text = re.sub(pattern, sign, text)
    return html.escape(text)


MINUS = re.compile(r"(?<![^\s(±,])-(?=\.?\d)|(?<=\de)-(?=\d)")  # of a number or its exponent
DIGEST = re.compile(r"\b[0-9a-f]{64}\b")
SHOWN = 12  # digits of a digest


def text_with_typographic_minus_signs(text: str) -> str:
    """Text with typographic minus signs.

    Those of figures.
    """
    return MINUS.sub("−", text)


def text_width(text: str, size: float) -> float:
    """Width of text on a figure, an upper bound.

    In the unit of `size`, its letters' height.
    """
    return size * sum(NARROW.get(letter, LETTER) for letter in text)


def wrap_text(text: str, size: float, room: float) -> list[str]:
    """Wrap text into lines no wider than room.

    A single longer word excepted.

    size, room : as in `text_width`.
    """
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
    """SVG figure of parts.

    It is WIDTH wide.
    title : for screen readers; values : attributes with a point's values
    """
    return (
        f'<svg class="figure" role="img" viewBox="0 0 {WIDTH} {height}" aria-label="{escape_html(title)}"{values}>'
        + "".join(parts)
        + "</svg>"
    )


def svg_text(x: float, y: float, words: str, anchor: str = "start", style: str = "") -> str:
    """SVG text at a position.

    anchor : start, middle or end; style : a class of figure.css
    """
    named = f' class="{style}"' if style else ""
    shown = text_with_typographic_minus_signs(words) if re.match(r"-\.?\d", words) else words
    return f'<text{named} x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape_html(shown)}</text>'


def svg_text_or_empty_if_too_large(box: tuple[float, float, float, float], words: str, style: str = "") -> str:
    """SVG text centred in a box, "" where it is too large for it.


    box : (left, top, width, height)
    """
    x, y, across, up = box
    size = TEXT if not style else SMALL
    return (
        svg_text(x + across / 2, y + up / 2 + 0.36 * size, words, "middle", style)
        if text_width(words, size) < across - 2 and size < up
        else ""
    )


def svg_tooltip(words: str) -> str:
    """SVG tooltip, to stand within a shape."""
    return f"<title>{escape_html(words)}</title>"


def round_ticks(low: float, high: float, most: int = 5) -> list[float]:
    """Round numbers for ticks within low .. high, `most` at the most.

    Raises ValueError for an empty range.
    """
    if not high > low:
        raise ValueError(f"expected a range, got {low:g} .. {high:g}")
    step = 10 ** math.floor(math.log10((high - low) / most))
    step = next(
        step * k for k in (1, 2, 5, 10, 20) if math.floor(high / (step * k)) - math.ceil(low / (step * k)) < most
    )
    return [round(k * step, 12) for k in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)]


LONG = 30  # letters, beyond which a cell breaks its lines
WORDY = 12  # letters, beyond which a heading of a column does


def inline_html(line: str) -> str:
    """Inline HTML of a line of text.

    Text between backticks becomes <code>.
    """
    parts = enumerate(re.split("`([^`]+)`", line))
    return "".join(f"<code>{html.escape(part)}</code>" if k % 2 else escape_html(part) for k, part in parts)


def capitalise_unless_name_or_sign(line: str) -> str:
    """Line with its first letter capitalised, unless its first word is a name or a sign.

    Or already capitalised.
    """
    first, *rest = line.split(" ", 1)
    return line[:1].upper() + line[1:] if rest and first.replace("-", "a").isalpha() and first.islower() else line


def heading_html(line: str, level: int = 2) -> str:
    """HTML of a heading.

    level : 2 of a section, 3 within one
    """
    return f"<h{level}>{inline_html(line)}</h{level}>"


def section_html(title: str, parts: Sequence[str]) -> list[str]:
    """HTML of a section, parts below a heading.

    Nothing where there are none.
    """
    return [heading_html(title), *parts] if parts else []


def paragraph_html(line: str) -> str:
    """HTML of a paragraph."""
    return f"<p>{inline_html(line)}</p>"


def note_html(line: str) -> str:
    """HTML of a note.

    In smaller type; it explains a figure or table.
    """
    return f'<p class="note">{inline_html(line)}</p>'


def figures_with_caption_html(figures: str, caption: str) -> str:
    """HTML of figures with a caption.

    Of one, or of several side by side, with the caption below.

    Pages number them.
    """
    return f'<figure class="plots">{figures}<figcaption>{inline_html(caption)}</figcaption></figure>'


def split_text_at_semicolons(text: str) -> list[str]:
    """Split a text at its semicolons.

    Those within brackets excepted.
    """
    return re.split(r"; (?![^()]*\))", text)


def list_html(lines: Iterable[str], ordered: bool = False) -> str:
    """HTML of a list of lines.

    Numbered where ordered.
    """
    tag = "ol" if ordered else "ul"
    return f"<{tag}>" + "".join(f"<li>{inline_html(line)}</li>" for line in lines) + f"</{tag}>"


def table_html(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """HTML of a table.

    It scrolls.

    header : of its columns, "" for one without; rows : of text and numbers
    """
    lines = [[str(cell) for cell in row] for row in rows]
    of_text = [_of_text(column) for column in zip(*lines)] or [False] * len(header)
    head = "".join(
        f'<th scope="col"{_style(cell, text, WORDY)}>{escape_html(cell)}</th>' if cell else "<td></td>"
        for cell, text in zip(header, of_text)
    )
    cells = [
        [
            f"<td{_style(DIGEST.sub('', cell), text, LONG)}>{_cell_html(cell, text)}</td>"
            for cell, text in zip(line, of_text)
        ]
        for line in lines
    ]
    body = "".join(f"<tr>{''.join(row)}</tr>" for row in cells)
    name = escape_html(", ".join(filter(None, header)))
    return (
        '<div class="scroll" tabindex="0" role="group" aria-label="table of '
        f'{name}"><table><tr>{head}</tr>{body}</table></div>'
    )


def _cell_html(cell: str, text: bool) -> str:
    """A cell's HTML. text : whether its column is of text; in others minus signs are those of print. Of a SHA-256 the
    first digits are shown, all of them in its title.
    """
    shown = escape_html(cell if text else text_with_typographic_minus_signs(cell))
    return DIGEST.sub(lambda found: f'<code title="SHA-256 {found[0]}">{found[0][:SHOWN]}</code>', shown)


def _of_text(column: Sequence[str]) -> bool:
    """Whether a column is of text, which begins at its left; of numbers, which end at its right, it is when half of its
    cells begin with one.
    """
    filled = [cell for cell in column if cell]
    return 2 * sum(re.match(r"[-+±]?[\d.]", cell) is not None for cell in filled) < len(filled)


def _style(cell: str, text: bool, long: int) -> str:
    classes = ["text"] * text + ["long"] * (len(cell) > long) + ["wraps"] * (text and WORDY < len(cell) <= long)
    return f' class="{" ".join(classes)}"' if classes else ""


def collapsible_section_html(summary: str, *parts: str) -> str:
    """HTML of a collapsible section.

    A summary line, and parts shown when it is opened.
    """
    return f"<details><summary>{inline_html(summary)}</summary>" + "".join(parts) + "</details>"
