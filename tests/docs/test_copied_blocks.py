"""Blocks of the documents can be copied: TOML parses, and remarks behind commands begin with #."""

import re
import tomllib

import pytest

from tests.docs.document_commands import PAGES, ROOT, without_remark

FENCES = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
INDENTED = re.compile(r"(?:^ {4}.*\n)+", re.MULTILINE)  # a paragraph of lines that are indented
TABLE = re.compile(r"\[\[?[a-z_.]+\]\]?(?: *#.*)?\n")  # a table's header, as rig.toml has them
OMITTED = re.compile(r'#.*|"[^"\n]*"')  # remarks and texts, where .. omits nothing
ALL = [*PAGES, ROOT / "CONTRIBUTING.md"]


def paragraphs(text: str) -> list[str]:
    """The indented paragraphs of a page, at the left margin."""
    return [re.sub("^ {4}", "", one, flags=re.MULTILINE) for one in INDENTED.findall(FENCES.sub("", text))]


def toml_blocks(text: str) -> list[str]:
    """The marked TOML blocks of a page, and its indented tables that omit nothing (..)."""
    tables = [one for one in paragraphs(text) if TABLE.match(one) and ".." not in OMITTED.sub("", one)]
    return [block for mark, block in FENCES.findall(text) if mark == "toml"] + tables


def bare_remarks(text: str) -> list[str]:
    """Lines of a page's blocks of commands with words behind two spaces or more that no # precedes."""
    marked = [block for mark, block in FENCES.findall(text) if mark in ("", "sh", "bash")]
    lines = [line for one in marked + paragraphs(text) if one.startswith("rig ") for line in one.splitlines()]
    return [line for line in lines if re.search(r"\S\s{2,}\S", without_remark(line))]


@pytest.mark.parametrize("page", ALL, ids=lambda path: path.name)
def test_toml_parses_and_remarks_behind_commands_are_remarks(page):
    text = page.read_text(encoding="utf-8")
    assert bare_remarks(text) == []
    for block in toml_blocks(text):
        assert tomllib.loads(block), block


def test_enough_blocks_are_found_and_faults_in_them_too():
    texts = [page.read_text(encoding="utf-8") for page in ALL]
    assert sum(len(toml_blocks(text)) for text in texts) > 40
    text = "    rig check REC     what is wrong\n    rig check A   # two  spaces\n"
    text += "\n    [sensors]\n    port = 1   bare\n"
    assert bare_remarks(text) == ["rig check REC     what is wrong"]
    with pytest.raises(tomllib.TOMLDecodeError):
        tomllib.loads(toml_blocks(text)[0])
