"""How text is set on a page: as HTML, units in their own letters, and how wide it comes out on a figure."""

import html
import re

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
    """Text as HTML; a length in um is written in µm, as the terminal cannot everywhere."""
    return html.escape(re.sub(r"\bu(m|rad)\b", r"µ\1", text))


def text_width(text: str, size: float) -> float:
    """Width of text on a figure, at the most, in the unit of its letters' height `size`."""
    return size * sum(NARROW.get(letter, LETTER) for letter in text)


def wrap_text(text: str, size: float, room: float) -> list[str]:
    """Lines of text that are no wider than there is room, a word alone aside. size, room : as in `text_width`."""
    lines = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".lstrip()
        if lines[-1] and text_width(longer, size) > room:
            lines.append(word)
        else:
            lines[-1] = longer
    return lines
