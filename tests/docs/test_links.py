"""Links of the documents resolve in a checkout, and every page is in the navigation of the site."""

import re
from pathlib import Path

import pytest
import yaml

from tests.docs.document_commands import ROOT

PAGES = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")]
PAGES += sorted((ROOT / "docs").rglob("*.md"))
MADE_BY_THE_SITE = {"troubleshooting.md", "api.md", "dependencies.md", "changelog.md"}
TARGET = re.compile(r"\]\(([^)\s]+)\)")
CODE = re.compile(r"^```.*?^```|^ {4}[^\n]*|`[^`\n]*`", re.MULTILINE | re.DOTALL)


def anchors(path: Path) -> set[str]:
    """The names to which a link into a page may point: its headings as sites name them, and its own anchors."""
    text = path.read_text(encoding="utf-8")
    headings = re.findall(r"^#+ (.+?)\s*$", re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text), re.MULTILINE)
    return {re.sub(r"[\s-]+", "-", re.sub(r"[^\w\s-]", "", name.lower())).strip("-") for name in headings} | set(
        re.findall(r'<a id="([\w-]+)">', text)
    )


def broken(page: Path, text: str) -> list[str]:
    """The targets of a page's links that are no file, or no anchor of one."""
    found = []
    for target in TARGET.findall(CODE.sub("", text)):
        if re.match(r"[a-z]+:", target):
            continue
        name, _, anchor = target.partition("#")
        path = (page.parent / name).resolve() if name else page
        if not path.exists() or (anchor and path.suffix == ".md" and anchor not in anchors(path)):
            found.append(target)
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_link_resolves_in_a_checkout(page):
    assert broken(page, page.read_text(encoding="utf-8")) == []


def test_what_is_not_there_is_found():
    page = ROOT / "docs" / "index.md"
    text = "[a](nothing.md) [b](glossary.md#ksf) [c](glossary.md#nothing) `[d](none.md)` [e](https://example.org)\n"
    assert broken(page, text) == ["nothing.md", "glossary.md#nothing"]


def named(tree: object) -> set[str]:
    """The files that a navigation names."""
    if isinstance(tree, str):
        return {tree}
    return set().union(*(named(part) for part in (tree.values() if isinstance(tree, dict) else tree)))


def test_every_page_and_the_changes_are_in_the_navigation():
    nav = named(yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8").split("\nnav:\n")[1]))
    docs = ROOT / "docs"
    written = {str(path.relative_to(docs)) for path in docs.rglob("*.md")}
    assert nav == written | MADE_BY_THE_SITE
