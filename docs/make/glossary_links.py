"""Every page's first use of a special word links to the glossary: python -m docs.make.glossary_links writes the links
that are missing.
"""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "glossary.md"
GENERATED = ("commands.md", "rig-toml.md", "tables.md", "effects.md", "results.md", "gallery.md", "validation.md")
ROW = re.compile(r'^\| <a id="([\w-]+)"></a>([^|]+?) \| (.+) \|$', re.MULTILINE)
ROWS = ROW.findall(PAGE.read_text(encoding="utf-8"))  # (anchor, word, meaning)
FORMS = {  # anchor: the word as pages use it, where that is not the word with or without an s, or is a common word too
    "action": "(?<=recommended )actions?",
    "corner": "corners? of (?:a |the )?markers?|marker corners?",
    "driver": "drivers? of (?:a |the )?controllers?",
    "exposure-frame": "exposures?(?! times?)",
    "family": "famil(?:y|ies) of laws",
    "further-pass": "further pass(?:es)?",
    "home": "home pose|(?<=at )home|(?<=from )home|(?<=relative to )home",
    "nominal-stated": "nominal",
    "place": "(?<=at these )places|(?<=with their )place|(?<=where an effect acts, its )place",
    "play": "backlash|(?<!may )(?<!can )play",
    "visit": "(?<=a )visit|(?<=first )visit|(?<=small )visits|(?<=more )visits|(?<=later )visits|(?<=of )visits",
    "rig": r"(?<=a \*)rig(?=\*)",
    "unknown": "`unknown`",
    "zero": "strut zeros|zeros of (?:the )?struts",
}


def forms(anchor: str, word: str) -> str:
    """Pattern of a word of the glossary as pages use it; abbreviations stand as they are."""
    plain = "|".join(re.escape(part).replace("\\ ", "[- ]") + "s?" * part.islower() for part in word.split(", "))
    return FORMS.get(anchor, plain)


SPECIAL = {anchor: forms(anchor, word) for anchor, word, _ in ROWS}
HIDDEN = re.compile(
    r"^(?: {4}|#|```)[^\n]*$|`[^`\n]*`|\$\$.*?\$\$|\$[^$\n]+\$|!?\[[^\]]*\]\([^)]*\)|<[^>\n]+>",
    re.MULTILINE | re.DOTALL,
)
FENCE = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)


def pages() -> list[Path]:
    """The written pages, without the glossary itself and those that are made from the code."""
    found = (
        sorted((ROOT / "docs").glob("*.md")) + sorted((ROOT / "docs" / "decisions").glob("*.md")) + [ROOT / "README.md"]
    )
    return [path for path in found if path != PAGE and path.name not in GENERATED]


def prose(text: str) -> str:
    """A page's text with all that is no prose, or a link already, blanked out: every character is where it was."""
    for pattern in (FENCE, HIDDEN):
        text = pattern.sub(lambda found: re.sub(r"[^\n]", "\0", found[0]), text)
    return text


def links(text: str) -> list[str]:
    """The anchors of the glossary to which a page links, in order."""
    return re.findall(r"\]\([\w./]*glossary\.md#([\w-]+)\)", text)


def linked(text: str, glossary: str) -> str:
    """A page with a link at the first use of each special word that it does not link yet. glossary : the path that
    links name
    """
    for anchor, word in SPECIAL.items():
        found = re.search(rf"\b(?:{word})\b", prose(text), re.IGNORECASE if word.islower() else 0)
        if found and anchor not in links(text):
            before, after = text[: found.start()], text[found.end() :]
            text = f"{before}[{found[0]}]({glossary}#{anchor}){after}"
    return text


def path_of(page: Path) -> str:
    """The glossary's path as a page names it."""
    return (
        "docs/glossary.md"
        if page.parent == ROOT
        else "../glossary.md"
        if page.parent.name == "decisions"
        else "glossary.md"
    )


def main() -> None:
    """Write the links that are missing."""
    for page in pages():
        text = page.read_text(encoding="utf-8")
        page.write_text(linked(text, path_of(page)), encoding="utf-8")


if __name__ == "__main__":
    main()
