"""Flesch reading ease and long sentences of the documents: `python -m tests.docs.readability` prints them by page."""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from docs.make.glossary_links import GENERATED
from tests.docs.document_commands import PAGES, ROOT

LONGEST = 25  # words of a sentence
MADE = {ROOT / "docs" / name for name in GENERATED}
WRITTEN = [page for page in PAGES if page not in MADE]

_FENCE = re.compile(r"^```.*?^```$|<!--.*?-->|\$\$.*?\$\$", re.MULTILINE | re.DOTALL)
_ITEM = re.compile(r"^\s*(?:[-*]|\d+\.)\s+")
_LEAD = re.compile(r"^\*\*[^*]+\*\*\s*")  # bold words that open a paragraph are its heading
_END = re.compile(r"(?<![.\s][.])(?<=[.!?])[)\"*]*\s+(?=[\"(*\[]*[A-Z0-9])")
_REPLACED = (
    (re.compile(r"!\[[^\]]*\]\([^)]*\)"), ""),
    (re.compile(r"\[([^\]]+)\]\([^)]*\)"), r"\1"),
    (re.compile(r"`[^`]*`"), "Command"),  # code and formulae count as one word of two syllables
    (re.compile(r"\$[^$]+\$"), "Value"),
    (re.compile(r"<[^>]+>"), ""),
)
_ABBREVIATION = re.compile(r"\b(e\.g|i\.e|vs|etc|Fig|eq|eqs|ch|No)\.", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Measure:
    """ease : Flesch reading ease, 100 very easy, 50 fairly difficult, 30 difficult; sentences, long : how many, and
    how many of them exceed LONGEST words; words : how many
    """

    ease: float
    sentences: int
    long: int
    words: int


def syllables(word: str) -> int:
    """Syllables of an English word by its groups of vowels, at least one; of a number one."""
    letters = re.sub(r"[^a-z]", "", word.lower())
    trimmed = re.sub(r"(?<=[^aeiouy])(?<![^aeiouy]l)es$|(?<=[^aeiouytd])ed$|(?<=[^aeiouyl])e$", "", letters)
    trimmed = re.sub(r"(?<=[aeiouy])le$", "l", trimmed)
    sibilant = re.search(r"(?:[cgsxz]|[cs]h)es$", letters)
    count = len(re.findall(r"[aeiouy]+", trimmed)) + bool(sibilant)
    count += len(re.findall(r"(?<![cstg])i[ao](?!u)|(?<!q)u[ao]|eo(?!u)|ia$|[^aeiou]ying", trimmed))
    count -= len(re.findall(r"(?<=[aeiouy][^aeiouyl])e(?=(?:ment|ly|ful|less)s?$)", trimmed))
    return max(count, 1)


def blocks(text: str, tables: bool = False) -> list[str]:
    """Paragraphs and items of lists, one line each, without code, headings and tables. tables : the cells of tables
    instead
    """
    found: list[str] = []
    open_block = listed = False
    for line in _FENCE.sub("", text).splitlines():
        row = line.lstrip().startswith("|")
        if not line.strip() or line.startswith("#") or row or (line.startswith("    ") and not listed):
            open_block, listed = False, listed and not line.strip()
            if tables and row and not set(line) <= set("|-: "):
                found += [cell.strip() for cell in re.split(r"(?<!\\)\|", line.strip()[1:-1]) if cell.strip()]
        elif not tables:
            if _ITEM.match(line):
                open_block, listed = False, True
            elif not line.startswith(" "):
                listed = listed and open_block
            found[len(found) - open_block :] = [(found[-1] + " " if open_block else "") + _ITEM.sub("", line.strip())]
            open_block = not line.endswith("  ")  # a line that is broken by hand ends what it says
    return found


def sentences(block: str) -> list[list[str]]:
    """The words of each sentence of a block; a block ends its last sentence, whatever it ends with."""
    for pattern, words in _REPLACED:
        block = pattern.sub(words, block)
    plain = _ABBREVIATION.sub(lambda found: found[0].replace(".", ""), _LEAD.sub("", block))
    split = [re.findall(r"[A-Za-z0-9][\w.,'\u2019/%-]*", part) for part in _END.split(plain)]
    return [words for words in split if words]


def measure(found: Iterable[list[str]]) -> Measure:
    """The figures of sentences. Raises ValueError where there is none."""
    all_sentences = list(found)
    words = [word for sentence in all_sentences for word in sentence]
    if not words:
        raise ValueError("no sentence to measure")
    spoken = sum(syllables(part) for word in words for part in word.split("-") if part)
    ease = 206.835 - 1.015 * len(words) / len(all_sentences) - 84.6 * spoken / len(words)
    return Measure(ease, len(all_sentences), sum(len(one) > LONGEST for one in all_sentences), len(words))


def page_sentences(path: Path, tables: bool = False) -> list[list[str]]:
    """The sentences of a page."""
    return [one for block in blocks(path.read_text(encoding="utf-8"), tables) for one in sentences(block)]


def main() -> None:
    """Print the figures of every page, the worst first, then of all."""
    rows = sorted((measure(page_sentences(path)).ease, path) for path in WRITTEN)
    for ease, path in rows:
        one = measure(page_sentences(path))
        print(f"{path.relative_to(ROOT)!s:32} ease {ease:5.1f}  long {one.long:3} of {one.sentences:4} sentences")
    total = measure(one for path in WRITTEN for one in page_sentences(path))
    mean = sum(ease for ease, _ in rows) / len(rows)
    print(
        f"mean of {len(rows)} pages {mean:.1f}, all their words {total.ease:.1f}; "
        f"{total.long} of {total.sentences} sentences ({total.long / total.sentences:.1%}) exceed {LONGEST} words"
    )
    cells = measure(one for path in WRITTEN for one in page_sentences(path, tables=True))
    made = measure(one for path in PAGES if path in MADE for one in page_sentences(path))
    print(f"apart: tables {cells.ease:.1f}, {cells.long / cells.sentences:.1%} long; generated pages {made.ease:.1f}")


if __name__ == "__main__":
    main()
