"""Drawings of a page that no caption explains."""

import re
from html.parser import HTMLParser

WORDS = 8  # of a caption at least
VOID = ("img", "br", "meta", "link", "input", "hr")


class _Captions(HTMLParser):
    """drawings : (what it is, numbers of the figures around it); captions : text of each figure"""

    def __init__(self) -> None:
        super().__init__()
        self.drawings: list[tuple[str, tuple[int, ...]]] = []
        self.captions: list[str] = []
        self._open: list[int] = []
        self._reading = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if tag == "figure":
            self._open.append(len(self.captions))
            self.captions.append("")
        self._reading |= tag == "figcaption"
        if tag in ("img", "canvas") or (tag == "svg" and given.get("class") == "figure"):
            self.drawings.append((str(given.get("aria-label") or given.get("alt")), tuple(self._open)))

    def handle_endtag(self, tag: str) -> None:
        if tag == "figure":
            self._open.pop()
        if tag == "figcaption":
            self._reading = False

    def handle_data(self, data: str) -> None:
        if self._reading:
            self.captions[self._open[-1]] += data


def unexplained_drawings(page: str) -> list[str]:
    """Names of a page's drawings without a caption that says what good and bad ones look like; the view in three
    dimensions says what it shows.
    """
    found = _Captions()
    found.feed(page)
    wanting = []
    for name, around in found.drawings:
        text = " ".join(found.captions[number] for number in around)
        whole = len(text.split()) >= WORDS and (re.search(r"\bGood\b", text) or "in three dimensions" in name)
        wanting += [] if whole else [name]
    return wanting
